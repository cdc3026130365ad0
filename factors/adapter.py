"""The one door between GTSAM's callback and NumPy.

GTSAM's ``CustomFactor`` crashes the interpreter when a Jacobian is left unassigned, is not
two-dimensional or has the wrong number of rows, and takes a wrong number of columns silently. The
adapter checks every result against the dimensions that the factor was made with, and turns what is
not finite into an error before GTSAM sees it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from geograph.errors import GeographError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import gtsam
    from numpy.typing import NDArray


class FactorError(GeographError, RuntimeError):
    """A factor's function returned what GTSAM cannot take."""


class ErrorFunction(Protocol):
    """What a factor evaluates."""

    def __call__(
        self, vectors: list[NDArray[np.float64]], jacobian: bool
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        """Return the whitened error and, if asked for, its derivative by each vector.

        Parameters
        ----------
        vectors
            The values of the factor's keys, one-dimensional.
        jacobian
            Whether derivatives are wanted; otherwise an empty list is returned.
        """
        ...


def vector_factor(
    keys: Sequence[int],
    sizes: Sequence[int],
    rows: int,
    function: ErrorFunction,
    *,
    noise: gtsam.noiseModel.Base | None = None,
) -> gtsam.CustomFactor:
    """Return a GTSAM factor of vector-valued keys that cannot crash the interpreter.

    Parameters
    ----------
    keys
        GTSAM keys of vectors.
    sizes
        Dimension of each key's vector.
    rows
        Dimension of the error.
    function
        Evaluates the error, and its derivatives on request.
    noise
        Noise model; None: unit noise (the function whitens).

    Returns
    -------
    factor
        Raises :class:`FactorError` when evaluated, if the function returns arrays of the wrong
        shape or values that are not finite.
    """
    # Imported here: the engine that uses the equations alone does without GTSAM.
    import gtsam

    expected = [(rows, size) for size in sizes]
    key_list = list(keys)

    def evaluate(
        this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[NDArray[np.float64]] | None
    ) -> NDArray[np.float64]:
        del this
        wanted = jacobians is not None
        error, derivatives = function([values.atVector(key) for key in key_list], wanted)
        error = np.ascontiguousarray(error, dtype=np.float64)
        if not np.isfinite(error).all():
            raise FactorError("a factor's error is not finite; check the values it is given")
        if wanted:
            matrices = [np.asfortranarray(part, dtype=np.float64) for part in derivatives]
            _check(error, matrices, rows, expected)
            assert jacobians is not None
            for index, matrix in enumerate(matrices):
                jacobians[index] = matrix
        elif error.shape != (rows,):
            raise FactorError(f"a factor's error has shape {error.shape}; expected ({rows},)")
        return error

    model = gtsam.noiseModel.Unit.Create(rows) if noise is None else noise
    return gtsam.CustomFactor(model, key_list, evaluate)


def _check(
    error: NDArray[np.float64],
    matrices: list[NDArray[np.float64]],
    rows: int,
    expected: list[tuple[int, int]],
) -> None:
    shapes = [matrix.shape for matrix in matrices]
    if error.shape != (rows,) or shapes != expected:
        raise FactorError(
            f"a factor returned an error of shape {error.shape} and derivatives of shapes "
            f"{shapes}; expected ({rows},) and {expected}"
        )
    if not all(np.isfinite(matrix).all() for matrix in matrices):
        raise FactorError("a factor's derivatives are not finite; check the values it is given")
