"""What a check-up finds, as data."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

Severity = Literal["problem", "question", "note"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that a colleague would point out before solving.

    Parameters
    ----------
    severity
        ``"problem"``: results will be wrong; ``"question"``: probably wrong, look; ``"note"``.
    kind
        A word for programs, such as ``"longitude-sign"``.
    sensor
        Whose it is; several names with commas, or empty: the recording's.
    file
        Where to look: ``recording.toml``, or the table.
    text
        What was found, with the figures that speak for it.
    remedy
        What to do.
    """

    severity: Severity
    kind: str
    sensor: str
    file: str
    text: str
    remedy: str

    def facts(self) -> dict[str, Any]:
        """Return the finding as plain values."""
        return dataclasses.asdict(self)


def degrees_text(angle_deg: float) -> str:
    """Return an angle with two digits: 0.012°, 35°."""
    return f"{angle_deg:.2g}°" if angle_deg < 99.5 else f"{angle_deg:.0f}°"
