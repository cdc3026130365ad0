"""How the shipped real recordings are made from their original files.

The recordings lie in ``scenarios/data``, each with its original files, so that anybody can make
them again; ``geograph example`` writes them out.
"""

from __future__ import annotations

from pathlib import Path

from geograph.io import read_ecsv, write
from geograph.io.atomic import replacing_file
from geograph.io.source import HEADER_NAME

DATA = Path(__file__).parent / "data"
"""The shipped recordings."""

WINCHCOMBE_CLOCK_OFFSET_S = {"DFNEXT065": 0.01, "UK000X": 5.0}
"""Prior 1-sigma: the first is disciplined by GPS, the second known to be seconds off."""

_WINCHCOMBE_TITLE = "The Winchcombe fireball of 2021-02-28, five cameras of five networks"


def make_winchcombe(folder: Path | str, *, originals: Path | None = None) -> None:
    """Make the recording of the Winchcombe fireball from the cameras' files.

    Every direction of every file is kept. Sigmas are the cameras' own scatter and priors those of
    :func:`geograph.io.read_ecsv`, but for the clocks of two cameras; nothing is known of the path.

    Parameters
    ----------
    folder
        The folder to write; a recording there is replaced.
    originals
        Folder of the cameras' files; by default the shipped ones.

    Raises
    ------
    InputError
        If a file is damaged or the folder holds something else.
    """
    source = DATA / "winchcombe" / "original" if originals is None else originals
    recording = read_ecsv(
        source, clock_offset_s=WINCHCOMBE_CLOCK_OFFSET_S, name=Path(folder).resolve().name
    )
    write(recording, folder, overwrite=True)
    header = Path(folder) / HEADER_NAME
    text = header.read_text(encoding="utf-8")
    with replacing_file(header) as staging:
        staging.write_text(f"# {_WINCHCOMBE_TITLE}\n{text}", encoding="utf-8")
