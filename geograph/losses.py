"""Losses of one measurement, as functions of its squared whitened residual.

A loss replaces r^2 / 2 by rho(r^2) / 2; its weight rho'(r^2) multiplies the measurement's
information in the next iteration (iteratively reweighted least squares; P. J. Huber, E. M.
Ronchetti, *Robust Statistics*, 2nd ed., 2009, chapter 7). The tuning constants give 95 % efficiency
on Gaussian scalar residuals (Z. Zhang, *Parameter estimation techniques*, Image and Vision
Computing 15, 1997, table 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_HUBER = 1.345
_CAUCHY = 2.3849
_GEMAN_MCCLURE = 3.0


@dataclass(frozen=True)
class Loss:
    """A loss by name: ``none``, ``huber``, ``cauchy`` or ``geman-mcclure``.

    Raises
    ------
    InputError
        If the name is unknown.
    """

    name: str

    def __post_init__(self) -> None:
        if self.name not in ("none", "huber", "cauchy", "geman-mcclure"):
            raise InputError(
                f"unknown loss {self.name!r}; expected none, huber, cauchy or geman-mcclure"
            )

    @property
    def tuning(self) -> float:
        """The tuning constant, in sigmas; 0 where every measurement counts as it is."""
        constants = {"huber": _HUBER, "cauchy": _CAUCHY, "geman-mcclure": _GEMAN_MCCLURE}
        return constants.get(self.name, 0.0)

    def value_and_weight(
        self, square: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return rho and its derivative for squared residuals, each of the shape given."""
        if self.name == "huber":
            root = np.sqrt(square)
            far = root > _HUBER
            value = np.where(far, 2.0 * _HUBER * root - _HUBER**2, square)
            weight = np.where(far, _HUBER / np.maximum(root, _HUBER), 1.0)
            return value, weight
        if self.name == "cauchy":
            ratio = square / _CAUCHY**2
            return _CAUCHY**2 * np.log1p(ratio), 1.0 / (1.0 + ratio)
        if self.name == "geman-mcclure":
            scale = _GEMAN_MCCLURE**2
            return scale * square / (scale + square), (scale / (scale + square)) ** 2
        return square, np.ones_like(square)
