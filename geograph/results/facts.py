"""Where an object at rest is, in figures that people read: the same on paper and on a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.ellipsoids import circular_error_probable_m
from geograph.units import fitting_unit

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from geograph.results.data import ErrorState, Results
    from geograph.units import Unit

_RADIUS_95 = float(np.sqrt(-2.0 * np.log(0.05)))


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with so many digits that count, never as a power of ten below a million."""
    text = f"{value:.{digits}g}"
    if "e" not in text or abs(value) >= 1e6:
        return text
    return np.format_float_positional(float(text), trim="-")


def estimate_text(error: ErrorState, unit: Unit) -> str:
    """Return an estimate and its sigma in a unit, without its name.

    The estimate has three digits, and more where its sigma is that much smaller.
    """
    estimate, sigma = error.estimate / unit.size, error.sigma / unit.size
    sign = "-" if estimate < 0.0 else "+"
    digits = 3
    if estimate != 0.0 and np.isfinite(estimate) and 0.0 < sigma < abs(estimate):
        # As far as the second digit of the sigma; a double has no more than fifteen.
        digits += int(np.floor(np.log10(abs(estimate))) - np.floor(np.log10(sigma))) - 1
    return f"{sign}{rounded(abs(estimate), min(max(digits, 3), 15))} ± {rounded(sigma, 2)}"


def place_text(latitude_deg: float, longitude_deg: float, digits: int = 6) -> str:
    """Return a place on the Earth: degrees north or south, east or west."""
    return (
        f"{abs(latitude_deg):.{digits}f}° {'N' if latitude_deg >= 0 else 'S'} "
        f"{abs(longitude_deg):.{digits}f}° {'E' if longitude_deg >= 0 else 'W'}"
    )


def length_text(*values_m: float) -> str:
    """Return lengths in one unit, with ``x`` between them."""
    unit = fitting_unit("m", values_m)
    return " x ".join(rounded(value / unit.size) for value in values_m) + f" {unit.name}"


def stage_text(stage: Mapping[str, Any]) -> str:
    """Return a sentence about one stage of the process noise, an entry of the summary's."""
    noise = stage["process_noise"]
    values = noise[:1] if len(set(noise)) == 1 else noise
    text = ", ".join(rounded(value) for value in values)
    along = stage.get("process_noise_along")
    if along is not None:
        text += f" across and {rounded(along)} along the velocity"
    return f"from {stage['from_s']:.6g} to {stage['to_s']:.6g} s: process noise {text}"


def static_facts(results: Results) -> list[tuple[str, str]]:
    """Return names and texts of what is known of an object at rest.

    Parameters
    ----------
    results
        Of a recording whose object is at rest; its first knot stands for all.
    """
    level = results.level_covariance_m2()[0]
    geodetic = results.geodetic()
    sigma = np.sqrt(np.maximum(np.diag(level), 0.0))
    facts = []
    if geodetic is None:
        x, y, z = results.position_m[0]
        facts.append(("position", f"x {x:.2f} m, y {y:.2f} m, z {z:.2f} m"))
        axes = ("x", "y", "z")
    else:
        latitude, longitude, height = geodetic[0]
        facts.append(("position", place_text(latitude, longitude)))
        facts.append(("height", f"{height:.1f} m above the ellipsoid"))
        axes = ("east", "north", "up")
    # A height that is given has no sigma of its own.
    count = 2 if results.height_held else 3
    pairs = zip(axes[:count], sigma[:count], strict=True)
    unit = fitting_unit("m", sigma[:count])
    texts = (f"{name} {rounded(s / unit.size)} {unit.name}" for name, s in pairs)
    facts.append(("1 sigma", ", ".join(texts)))
    flat = level[:2, :2]
    if np.isfinite(flat).all():
        semi_axes, direction = _ellipse(flat, earth=geodetic is not None)
        facts.append(("1-sigma ellipse", length_text(*semi_axes)))
        facts.append(("its major axis", direction))
        facts.append(("95 % ellipse", length_text(*(_RADIUS_95 * semi_axes))))
        facts.append(("CEP (50 %)", length_text(float(circular_error_probable_m(flat[None])[0]))))
    miss = _miss_m(results)
    if miss is not None:
        facts.append(("off the truth", f"{length_text(miss)} over ground"))
    return facts


def _ellipse(covariance: NDArray[np.float64], *, earth: bool) -> tuple[NDArray[np.float64], str]:
    """Return descending semi-axes, and how the major one lies."""
    values, vectors = np.linalg.eigh(covariance)
    across, along = vectors[:, 1]
    angle = np.degrees(np.arctan2(across, along) if earth else np.arctan2(along, across)) % 180.0
    where = "azimuth {:.1f}°" if earth else "{:.1f}° from x towards y"
    return np.sqrt(np.maximum(values[::-1], 0.0)), where.format(angle)


def _miss_m(results: Results) -> float | None:
    """Return the level distance to the truth, None where that is not known or not at rest."""
    truth = results.truth
    if truth is None or np.ptp(truth.position_m, axis=0).max() > 0.0:
        return None
    error = results.level_axes()[0] @ (results.position_m[0] - truth.position_m[0])
    return float(np.linalg.norm(error[:2]))
