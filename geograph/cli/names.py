"""Names that shells complete, and versions that reports of faults name."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

if TYPE_CHECKING:
    from collections.abc import Callable

_OPTIONAL = ("astropy", "distributed", "pyarrow", "rasterio", "sgp4", "xarray")
"""What the extras bring."""


def example_names(incomplete: str) -> list[str]:
    """Return the examples whose names begin so."""
    from geograph.examples import titles

    return [name for name in titles() if name.startswith(incomplete)]


def scenario_names(incomplete: str) -> list[str]:
    """Return the scenarios whose names begin so."""
    from geograph.scenarios.registry import scenarios

    return [name for name in scenarios() if name.startswith(incomplete)]


def one_of(setting: str) -> Callable[[str], list[str]]:
    """Return what completes the names that a setting may have."""

    def names(incomplete: str) -> list[str]:
        from geograph import recording
        from geograph.io.convert import FORMATS

        known = {
            "motion": get_args(recording.MotionName),
            "loss": get_args(recording.LossName),
            "elimination": get_args(recording.EliminationName),
            "format": FORMATS,
        }
        return [name for name in known[setting] if name.startswith(incomplete)]

    return names


def versions_text() -> str:
    """Return the versions of geograph and of all that it uses here, as text of a few lines."""
    import platform
    from importlib.metadata import PackageNotFoundError, requires, version
    from re import match

    from geograph.kernels import compiled

    def installed(name: str) -> str | None:
        try:
            return f"{name} {version(name)}"
        except PackageNotFoundError:
            return None

    needed = [line for line in requires("geograph") or () if "extra ==" not in line]
    names = sorted(found[0] for line in needed if (found := match(r"[\w.-]+", line)))
    extras = [text for name in _OPTIONAL if (text := installed(name))]
    return (
        f"{installed('geograph')} (Python {platform.python_version()}, {platform.machine()}; "
        f"kernels {'compiled' if compiled else 'NumPy alone'})\n"
        f"needs: {', '.join(text for name in names if (text := installed(name)))}\n"
        f"extras: {', '.join(extras) or 'none'}"
    )
