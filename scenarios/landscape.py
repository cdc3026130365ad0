"""Synthetic terrain: hills, ridges and valleys, as a smooth function and as a raster.

The ground is a sum of three things, all drawn from a seed, all with an exact gradient:

- **hills**: plane waves of random direction and phase, whose amplitude grows with the wavelength to
  a power, as in measured terrain (a power-law spectrum);
- **ridges** and **valleys**: folds, functions of the sine of a bent phase, so that crests and
  river beds run through the land in curves, one beside the other;
- **pins**: small smooth corrections, so that chosen places have a chosen height and slope.

A world of a study asks the function; a raster (:mod:`geograph.scenarios.elevation_model`) holds
samples of it. Nothing of ``geograph.factors`` or of the reader of rasters is used here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

_CREST = 0.15
"""How round a crest is: the sine at which a ridge's flank turns into its top."""

_BED = 0.25
"""How wide a valley's bed is, as a sine."""


@dataclass(frozen=True, kw_only=True)
class Pin:
    """A place whose height and slope are given.

    Parameters
    ----------
    place_m
        x and y, metres.
    height_m
        Height there.
    slope
        Rise over run towards x and y.
    """

    place_m: tuple[float, float]
    height_m: float
    slope: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Relief:
    """What the land is like.

    Parameters
    ----------
    base_m
        Mean height of the hills.
    hills_m
        Standard deviation of the hills' height.
    longest_m, shortest_m
        Wavelengths of the hills.
    power
        Amplitude of a wave goes with its wavelength to this power.
    ridge_m, valley_m
        Height of ridges, depth of valleys.
    folds_m
        Distance between two ridges, or two valleys.
    waves
        Number of plane waves.
    """

    base_m: float
    hills_m: float
    longest_m: float
    shortest_m: float
    power: float = 1.2
    ridge_m: float = 0.0
    valley_m: float = 0.0
    folds_m: float = 3e3
    waves: int = 40

    def __post_init__(self) -> None:
        if not 0.0 < self.shortest_m < self.longest_m:
            raise ValueError(
                f"wavelengths from {self.shortest_m} to {self.longest_m} m; "
                "expected 0 < shortest_m < longest_m"
            )


HILLS = Relief(
    base_m=160.0, hills_m=14.0, longest_m=6e3, shortest_m=400.0, ridge_m=25.0, valley_m=25.0
)
"""Low wooded hills of central Sweden, the land of Kallin (2021): some 100 to 220 m high."""

MOUNTAINS = Relief(
    base_m=700.0,
    hills_m=120.0,
    longest_m=9e3,
    shortest_m=500.0,
    ridge_m=700.0,
    valley_m=350.0,
    folds_m=3.5e3,
)
"""Ranges with crests up to 1500 m above the valleys, a few kilometres apart."""


@dataclass(frozen=True, eq=False)
class _Fold:
    """A ridge or a valley: ``size_m`` times a function of sin(k.x + phase + bend sin(q.x + turn)).

    ``size_m`` is negative for valleys.
    """

    kind: Literal["ridge", "valley"]
    size_m: float
    wave: NDArray[np.float64]
    phase: float
    bend: float
    bend_wave: NDArray[np.float64]
    turn: float

    def evaluate(
        self, place_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return heights, shape (...), and gradients, shape (..., 2)."""
        inner = place_m @ self.bend_wave + self.turn
        outer = place_m @ self.wave + self.phase + self.bend * np.sin(inner)
        sine, cosine = np.sin(outer), np.cos(outer)
        if self.kind == "ridge":
            flank = np.sqrt(sine**2 + _CREST**2)
            height = 1.0 - flank / np.hypot(1.0, _CREST)
            slope = -sine / (flank * np.hypot(1.0, _CREST))
        else:
            height = np.exp(-0.5 * (sine / _BED) ** 2)
            slope = -sine / _BED**2 * height
        along = self.wave + (self.bend * np.cos(inner))[..., None] * self.bend_wave
        return self.size_m * height, self.size_m * (slope * cosine)[..., None] * along


@dataclass(frozen=True, eq=False)
class Landscape:
    """Smooth ground over the whole plane; made by :func:`make_landscape`.

    Attributes
    ----------
    relief
        What it was drawn from.
    wave
        Shape (n, 2): wave vectors of the hills, rad/m.
    amplitude_m, phase
        Shape (n,).
    folds
        Ridges and valleys.
    pin_m
        Shape (m, 2): places of the pins.
    pin_weight
        Shape (m, 3): weights of each pin's bump and of its two tilts, metres.
    """

    relief: Relief
    wave: NDArray[np.float64]
    amplitude_m: NDArray[np.float64]
    phase: NDArray[np.float64]
    folds: tuple[_Fold, ...]
    pin_m: NDArray[np.float64]
    pin_weight: NDArray[np.float64]

    def height(self, x_m: ArrayLike, y_m: ArrayLike) -> NDArray[np.float64]:
        """Return heights, metres, of the shape that x and y broadcast to."""
        return self.evaluate(x_m, y_m)[0]

    def gradient(self, x_m: ArrayLike, y_m: ArrayLike) -> NDArray[np.float64]:
        """Return slopes towards x and y, shape (..., 2)."""
        return self.evaluate(x_m, y_m)[1]

    def evaluate(
        self, x_m: ArrayLike, y_m: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return heights, shape (...), metres, and gradients, shape (..., 2).

        Parameters
        ----------
        x_m, y_m
            Places, any shapes that broadcast, metres.
        """
        x, y = np.broadcast_arrays(np.asarray(x_m, float), np.asarray(y_m, float))
        place = np.stack([x, y], axis=-1)
        angle = place @ self.wave.T + self.phase
        height = self.relief.base_m + np.cos(angle) @ self.amplitude_m
        gradient = -(np.sin(angle) * self.amplitude_m) @ self.wave
        for fold in self.folds:
            more, slope = fold.evaluate(place)
            height, gradient = height + more, gradient + slope
        for pin, weight in zip(self.pin_m, self.pin_weight, strict=True):
            more, slope = _bump(place - pin, weight)
            height, gradient = height + more, gradient + slope
        return height, gradient

    def grid(self, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return heights on a grid along the axes, shape (y, x), metres.

        The same as :meth:`height`, many times faster: a plane wave on a grid is a product of one
        wave in x and one in y, so the hills are a product of two matrices.
        """
        waves_x = np.exp(1j * (np.outer(self.wave[:, 0], x_m) + self.phase[:, None]))
        waves_y = self.amplitude_m[:, None] * np.exp(1j * np.outer(self.wave[:, 1], y_m))
        height = self.relief.base_m + waves_y.real.T @ waves_x.real - waves_y.imag.T @ waves_x.imag
        place = np.stack(np.meshgrid(x_m, y_m), axis=-1)
        for fold in self.folds:
            height += fold.evaluate(place)[0]
        for pin, weight in zip(self.pin_m, self.pin_weight, strict=True):
            height += _bump(place - pin, weight)[0]
        return np.asarray(height)


_PIN_WIDTH_M = 500.0


def _bump(
    offset_m: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return height and gradient of (w0 + w1 u + w2 v) exp(-(u^2 + v^2) / 2), u and v in widths."""
    scaled = offset_m / _PIN_WIDTH_M
    bell = np.exp(-0.5 * np.sum(scaled**2, axis=-1))
    factor = weight[0] + scaled @ weight[1:]
    gradient = (weight[1:] - factor[..., None] * scaled) * bell[..., None] / _PIN_WIDTH_M
    return factor * bell, gradient


def make_landscape(relief: Relief, *, seed: int, pins: Sequence[Pin] = ()) -> Landscape:
    """Draw a terrain; the same seed gives the same ground.

    Parameters
    ----------
    relief
        :data:`HILLS`, :data:`MOUNTAINS`, or another.
    seed
        Whole number of at least 0.
    pins
        Places whose height and slope are given; farther apart than a kilometre or so.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7411,)))
    # Wavelengths evenly spread in octaves.
    octaves = rng.uniform(np.log(relief.shortest_m), np.log(relief.longest_m), relief.waves)
    length = np.exp(octaves)
    direction = rng.uniform(0.0, 2.0 * np.pi, relief.waves)
    wave = 2.0 * np.pi / length[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    amplitude = length**relief.power
    amplitude *= relief.hills_m * np.sqrt(2.0) / np.linalg.norm(amplitude)
    phase = rng.uniform(0.0, 2.0 * np.pi, relief.waves)
    folds = []
    sizes: tuple[tuple[Literal["ridge", "valley"], float], ...] = (
        ("ridge", relief.ridge_m),
        ("valley", -relief.valley_m),
    )
    for kind, size in sizes:
        way = rng.uniform(0.0, np.pi)
        # The sine's square has half its wavelength.
        along = np.pi / relief.folds_m * np.array([np.cos(way), np.sin(way)])
        across = 0.6 * np.pi / relief.folds_m * np.array([-np.sin(way), np.cos(way)])
        turns = rng.uniform(0.0, 2.0 * np.pi, 2)
        folds.append(_Fold(kind, size, along, turns[0], 0.8, across, turns[1]))
    bare = Landscape(
        relief, wave, amplitude, phase, tuple(folds), np.zeros((0, 2)), np.zeros((0, 3))
    )
    return _pinned(bare, pins) if pins else bare


def _pinned(bare: Landscape, pins: Sequence[Pin]) -> Landscape:
    """Return the terrain with the pins' heights and slopes: three linear equations for each."""
    place = np.array([pin.place_m for pin in pins])
    height, gradient = bare.evaluate(place[:, 0], place[:, 1])
    wanted = np.array([(pin.height_m, *pin.slope) for pin in pins])
    missing = wanted - np.concatenate([height[:, None], gradient], axis=1)
    matrix = np.zeros((3 * len(pins), 3 * len(pins)))
    for j, pin in enumerate(place):
        for part in range(3):
            more, slope = _bump(place - pin, np.eye(3)[part])
            matrix[:, 3 * j + part] = np.concatenate([more[:, None], slope], axis=1).ravel()
    weight = np.linalg.solve(matrix, missing.ravel()).reshape(-1, 3)
    return Landscape(
        bare.relief, bare.wave, bare.amplitude_m, bare.phase, bare.folds, place, weight
    )
