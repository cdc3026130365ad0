"""Keywords of tracking data messages that are refused or passed over, and frames that are read."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection

PASSED_OVER = re.compile(
    r"MAG|RCS|PRESSURE|TEMPERATURE|RHUMIDITY|CARRIER_POWER|PC_N0|PR_N0|STEC|TROPO_(DRY|WET)|"
    r"TRANSMIT_FREQ_\d|TRANSMIT_FREQ_RATE_\d"
)
"""Records that say nothing of where the object was (TRANSMIT_FREQ gives the carrier)."""

_NOT_READ = {
    "RANGE": "ranges are active measurements, for which there is no factor",
    "DOPPLER": "range rates are active measurements, for which there is no factor",
    "RECEIVE_FREQ": "the frequency at one station depends on the object's unknown oscillator; "
    "differences (MODE = SINGLE_DIFF) are read",
    "RECEIVE_PHASE": "phase counts are not read",
    "TRANSMIT_PHASE": "phase counts are not read",
    "CLOCK": "clock measurements are not read; give the station's clock a prior in the list",
}

FRAMES = {
    # The realisations of the ICRF agree to a ten-thousandth of an arc second.
    **dict.fromkeys(("ICRF", "ICRF1", "ICRF2", "ICRF3", "GCRF"), float("nan")),
    "EME2000": 2000.0,
    "J2000": 2000.0,
}
"""Reference frames of right ascension and declination, with their equinox."""


def why_not(keyword: str, *, differenced: bool) -> str | None:
    """Return why records of a keyword are refused, None if they are not of those."""
    if differenced and keyword == "RECEIVE_FREQ":
        return None
    return next((why for start, why in _NOT_READ.items() if keyword.startswith(start)), None)


def flags_to_ignore(keywords: Collection[str], ignore: Collection[str]) -> str:
    """Return the flags that pass over what would be refused of a file's keywords, six at most."""
    refused = [name for name in keywords if name not in ignore and why_not(name, differenced=False)]
    return " ".join(f"--ignore {name[:40]}" for name in refused[:6])
