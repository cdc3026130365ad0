"""Noise of a factor that stacks several measurements: checks, and whitening."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def column(value: ArrayLike, name: str, count: int) -> NDArray[np.float64]:
    """Return n finite numbers, shape (n,); raise InputError otherwise."""
    found = np.asarray(value, dtype=np.float64)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise InputError(
            f"{name} is {value!r}; expected {count} finite numbers, one for every receiver"
        )
    return found


def sigmas(value: ArrayLike, name: str, count: int) -> NDArray[np.float64]:
    """Return n positive numbers, shape (n,), of one or n; raise InputError otherwise."""
    found = np.asarray(value, dtype=np.float64)
    if found.shape not in ((), (count,)) or not (np.isfinite(found) & (found > 0.0)).all():
        raise InputError(
            f"{name} is {value!r}; expected one finite number above 0, or {count} of them"
        )
    return np.broadcast_to(found, (count,))


def whitening(
    sigma: ArrayLike | None,
    sigma_reference: float,
    covariance: ArrayLike | None,
    count: int,
    *,
    unit: str,
) -> NDArray[np.float64]:
    """Return the inverse of a root of a covariance, shape (n, n).

    Parameters
    ----------
    sigma
        One number or shape (n,): standard deviations; None with a covariance.
    sigma_reference
        The part of them that is common to all; its square is the covariance of any two.
    covariance
        Shape (n, n), in place of the sigmas.
    count
        n.
    unit
        For messages.

    Raises
    ------
    InputError
        If there is no positive definite covariance in what is given.
    """
    if (sigma is None) == (covariance is None):
        raise InputError(
            f"sigma_{unit} is {sigma!r} and covariance_{unit}2 is {covariance!r}; expected "
            "exactly one of them"
        )
    if sigma is not None:
        own = sigmas(sigma, f"sigma_{unit}", count)
        if not 0.0 <= sigma_reference < own.min(initial=np.inf):
            raise InputError(
                f"sigma_reference_{unit} is {sigma_reference}; expected at least 0, and below "
                f"every sigma_{unit} ({own.min():g})"
            )
        total = np.full((count, count), float(sigma_reference) ** 2)
        total[np.arange(count), np.arange(count)] = own**2
    else:
        total = np.asarray(covariance, dtype=np.float64)
        if total.shape != (count, count) or not np.isfinite(total).all():
            raise InputError(
                f"covariance_{unit}2 has shape {total.shape}; expected ({count}, {count}), finite"
            )
        if not np.allclose(total, total.T, rtol=1e-9, atol=0.0):
            raise InputError(f"covariance_{unit}2 is not symmetric; expected a covariance")
    # Scaled first: a covariance in s^2 has entries that look like zeros.
    scale = np.sqrt(np.diagonal(total)) if (np.diagonal(total) > 0.0).all() else np.ones(count)
    try:
        root = np.linalg.cholesky(total / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        raise InputError(
            f"covariance_{unit}2 is not positive definite; expected a covariance"
        ) from None
    return np.asarray(np.linalg.inv(root) / scale)


def vector3(value: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return three finite numbers; raise InputError otherwise."""
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name} is {value!r}; expected three finite numbers")
    return vector
