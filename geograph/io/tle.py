"""Two-line elements as a trajectory: SGP4 through the package sgp4."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geograph.earth import earth_fixed_from_teme
from geograph.errors import InputError
from geograph.io.instants import DAY_NS, SECOND_NS, tai_to_utc_ns
from geograph.io.messages import shown
from geograph.io.source import decode, read_file
from geograph.io.trajectories import LONGEST_STEP_S, Span
from geograph.sensors import Trajectory

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

_JD_1970 = 2440587.5
_LONGEST_SPAN_S = 30.0 * 86400.0


def read_tle(
    path: Path, epoch_tai_ns: int, span_s: Span, *, content: bytes | None = None
) -> Trajectory:
    """Return where a satellite of two-line elements was, in ECEF, every 10 s of a span.

    Elements are good to about a kilometre on their day, and worse away from it; what a sensor's
    place is worth belongs into its ``position_m`` prior.

    Parameters
    ----------
    path
        A file of one satellite: two lines, with or without one of its name before them.
    epoch_tai_ns
        Instant from which seconds count (:mod:`geograph.io.instants`).
    span_s
        What is wanted, seconds.
    content
        What the file holds, if it is in an archive.

    Raises
    ------
    InputError
        If the elements are damaged, SGP4 fails, or a package is missing.
    """
    satellite = _satellite(path, read_file(path) if content is None else content)
    first, last = span_s
    if last - first > _LONGEST_SPAN_S:
        raise InputError(
            f"is wanted for {(last - first) / 86400.0:.0f} days; expected 30 at most, beyond which "
            "elements mean nothing; split the measurements",
            path=path,
        )
    time = np.linspace(first, last, int(np.ceil((last - first) / LONGEST_STEP_S)) + 2)
    tai = epoch_tai_ns + np.round(time * SECOND_NS).astype(np.int64)
    utc = np.array([tai_to_utc_ns(int(value)) for value in tai], dtype=np.int64)
    days, rest = np.divmod(utc, DAY_NS)
    errors, position_km, _ = satellite.sgp4_array(_JD_1970 + days, rest / DAY_NS)
    if errors.any():
        from sgp4.api import SGP4_ERRORS

        raise InputError(
            f"cannot be propagated: {SGP4_ERRORS[int(errors[np.argmax(errors > 0)])]}; expected "
            "elements of about the time of the measurements",
            path=path,
        )
    turn = earth_fixed_from_teme(tai, path, "tle")
    position = np.einsum("nij,nj->ni", turn, position_km * 1e3)
    return Trajectory((tai - epoch_tai_ns) / SECOND_NS, position)


def _satellite(path: Path, content: bytes) -> Any:
    try:
        from sgp4.api import Satrec
    except ImportError:
        raise InputError(
            "holds two-line elements and sgp4 is not installed; run pip install 'geograph[tle]'",
            path=path,
        ) from None
    lines = [
        (number, line.rstrip())
        for number, line in enumerate(decode(content, path).splitlines(), start=1)
        if line.strip()
    ]
    marked = [entry for entry in lines if entry[1][:2] in ("1 ", "2 ")]
    if len(marked) != 2 or marked[0][1][0] != "1" or marked[1][1][0] != "2" or len(lines) > 3:
        raise InputError(
            f"has {len(lines)} lines, {len(marked)} of elements; expected line 1 and line 2 of one "
            "satellite, and its name at most",
            path=path,
        )
    for number, line in marked:
        _check(number, line, path)
    if marked[0][1][2:7] != marked[1][1][2:7]:
        raise InputError(
            f"lines are of satellites {shown(marked[0][1][2:7])} and {shown(marked[1][1][2:7])}; "
            "expected one",
            path=path,
            line=marked[1][0],
        )
    try:
        return Satrec.twoline2rv(marked[0][1], marked[1][1])
    except ValueError as error:
        raise InputError(
            f"are not two-line elements ({str(error)[:120]})", path=path, line=marked[0][0]
        ) from None


def _check(number: int, line: str, path: Path) -> None:
    if len(line) != 69 or not line.isascii():
        raise InputError(
            f"has {len(line)} characters; expected the 69 of a line of elements",
            path=path,
            line=number,
        )
    total = sum(int(letter) if letter.isdecimal() else letter == "-" for letter in line[:68])
    if line[68] != str(total % 10):
        raise InputError(
            f"has the checksum {shown(line[68])}, and its digits add up to {total % 10}; expected "
            "an undamaged line; copy it again",
            path=path,
            line=number,
        )
