"""Conversion between the formats of recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.io.atomic import check_replaceable
from geograph.io.ecsv import DEFAULT_CLOCK_OFFSET_S, ecsv_files, read_ecsv
from geograph.io.reader import read
from geograph.io.source import HEADER_NAME
from geograph.io.writer import TableFormat, write

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geograph.io.ecsv import PerCamera
    from geograph.recording import Recording


def convert(
    inputs: Sequence[Path | str],
    output: Path | str,
    *,
    tables: TableFormat = "csv",
    clock_offset_s: PerCamera = DEFAULT_CLOCK_OFFSET_S,
    bias_deg: PerCamera | None = None,
    sigma_deg: PerCamera | None = None,
    overwrite: bool = False,
) -> Recording:
    """Write what was read in one format in another.

    Parameters
    ----------
    inputs
        Fireball files of the GFE standard (.ecsv) or folders of them, which make one recording; or
        one recording, a folder or a .zip archive.
    output
        The recording to write: a folder, or a .zip archive if its name ends so.
    tables
        Format of its tables, ``"csv"`` or ``"parquet"``.
    clock_offset_s, bias_deg, sigma_deg
        See :func:`geograph.io.read_ecsv`; not for recordings, which have their own.
    overwrite
        Whether an older recording in place of ``output`` is replaced.

    Returns
    -------
    Recording
        As read back from what was written.

    Raises
    ------
    InputError
        If an input is wrong, inputs of different formats are mixed, or the output is in use.
    """
    paths = [Path(path) for path in inputs]
    target = Path(output)
    if not paths:
        raise InputError("nothing to convert; expected .ecsv files, a folder or a .zip archive")
    if target.suffix.lower() != ".zip" and not overwrite:
        check_replaceable(target, markers=())
    if any(_is_ecsv(path) for path in paths):
        for path in paths:
            if not _is_ecsv(path):
                raise InputError(
                    "is not an .ecsv file or a folder of them; expected one format; convert "
                    "recordings by themselves",
                    path=path,
                )
        recording = read_ecsv(
            ecsv_files(paths),
            clock_offset_s=clock_offset_s,
            bias_deg=bias_deg,
            sigma_deg=sigma_deg,
            name=target.stem,
        )
    elif len(paths) > 1:
        raise InputError(
            f"{len(paths)} recordings; expected one, or .ecsv files; convert one at a time",
            path=paths[1],
        )
    else:
        recording = read(paths[0])
        if (
            bias_deg is not None
            or sigma_deg is not None
            or (clock_offset_s != DEFAULT_CLOCK_OFFSET_S)
        ):
            raise InputError(
                "is a recording, which has its own sigmas and priors; expected no clock_offset_s, "
                "bias_deg or sigma_deg; edit the recording",
                path=paths[0],
            )
    return write(recording, target, overwrite=overwrite, tables=tables)


def _is_ecsv(path: Path) -> bool:
    if path.is_dir():
        return not (path / HEADER_NAME).exists() and any(
            entry.suffix.lower() == ".ecsv" for entry in path.iterdir()
        )
    return path.suffix.lower() == ".ecsv"
