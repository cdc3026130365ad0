"""Height above the ground: the surface between grid points, and the constraint on a position.

Between the points of a grid the surface is cubic convolution (R. G. Keys, *Cubic convolution
interpolation for digital image processing*, IEEE TASSP 29, 1981, a = -1/2; the same as Catmull-Rom
splines): through every grid point, with a continuous gradient, from the 4 x 4 points around alone.
Bilinear interpolation has edges along every grid line, at which a solver's steps do not converge.

**Sign.** The height above terrain is the height of the object less that of the ground straight
below or above it, along the normal of the ellipsoid (along z in a local frame).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from geograph.factors.constraints import altitude

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Surface(Protocol):
    """Ground whose height is known everywhere; :class:`geograph.Terrain` is one."""

    def elevation(
        self, position_m: NDArray[np.float64], *, jacobian: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return heights of the ground at positions, and their gradients.

        Parameters
        ----------
        position_m
            Shape (n, 3), metres, in the frame.
        jacobian
            Whether gradients by the position, shape (n, 3), are returned too.

        Returns
        -------
        height, gradient
            Heights, shape (n,), metres above the ellipsoid, or z in a local frame.
        """
        ...

    def known(self, position_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return where the ground's height is known, shape (n,), at positions of shape (n, 3)."""
        ...


def height_above_terrain(
    position_m: NDArray[np.float64],
    frame: Literal["ecef", "local"],
    surface: Surface,
    *,
    jacobian: bool = False,
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Return heights above the ground, shape (n,), metres, and gradients by position, (n, 3).

    Parameters
    ----------
    position_m
        Shape (n, 3), in the frame.
    frame
        ``"ecef"`` or ``"local"``.
    surface
        The ground.
    jacobian
        Whether gradients are returned too.
    """
    height, up = altitude(position_m, frame)
    ground, slope = surface.elevation(position_m, jacobian=jacobian)
    return height - ground, None if slope is None else up - slope


def cubic_convolution(
    patch: NDArray[np.float64], row: NDArray[np.float64], column: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return values and derivatives by row and column between the points of a grid.

    Parameters
    ----------
    patch
        Shape (n, 4, 4): the grid's values at rows and columns -1, 0, 1, 2 about each cell.
    row, column
        Shape (n,): place in the cell, 0 to 1 from its first point to its second.

    Returns
    -------
    value, by_row, by_column
        Each shape (n,), the derivatives per grid spacing.
    """
    weight_row, slope_row = _weights(row)
    weight_column, slope_column = _weights(column)
    along = np.einsum("nij,nj->ni", patch, weight_column)
    across = np.einsum("nij,nj->ni", patch, slope_column)
    return (
        np.asarray(np.einsum("ni,ni->n", along, weight_row)),
        np.asarray(np.einsum("ni,ni->n", along, slope_row)),
        np.asarray(np.einsum("ni,ni->n", across, weight_row)),
    )


# Weights of the points at -1, 0, 1, 2 as polynomials of the place t between 0 and 1: rows are the
# powers of t.
_WEIGHTS = np.array(
    [[0.0, 1.0, 0.0, 0.0], [-0.5, 0.0, 0.5, 0.0], [1.0, -2.5, 2.0, -0.5], [-0.5, 1.5, -1.5, 0.5]]
)


def _weights(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the four weights and their derivatives, each shape (n, 4)."""
    powers = np.empty((t.size, 4))
    powers[:, 0], powers[:, 1] = 1.0, t
    powers[:, 2] = t * t
    powers[:, 3] = powers[:, 2] * t
    return powers @ _WEIGHTS, powers[:, :3] @ (_WEIGHTS[1:] * np.array([[1.0], [2.0], [3.0]]))
