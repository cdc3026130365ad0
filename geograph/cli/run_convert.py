"""What ``geograph convert`` does: options for each camera, and the conversion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.io import convert, read

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from geograph.io import ForeignOptions
    from geograph.io.writer import TableFormat


def run_convert(
    paths: Sequence[Path],
    options: Mapping[str, Sequence[str] | None],
    *,
    tables: TableFormat,
    foreign: ForeignOptions | None = None,
    overwrite: bool,
) -> None:
    """Convert all paths but the last into the last.

    Parameters
    ----------
    paths
        Inputs and the output: a recording, or the .jsonl file of a feed.
    options
        Values by the names of :func:`geograph.io.convert`, as given: ``VALUE`` for all cameras or
        ``CAMERA=VALUE`` for one, which then has that of its own.
    tables, foreign, overwrite
        As in :func:`geograph.io.convert`.

    Raises
    ------
    InputError
        If anything given is wrong.
    """
    if len(paths) < 2:
        raise InputError("expected one input or more, and then what to write")
    if paths[-1].suffix.lower() == ".jsonl":
        _write_feed(paths, overwrite=overwrite)
        return
    given = {name: per_camera(name, texts) for name, texts in options.items() if texts}
    convert(paths[:-1], paths[-1], tables=tables, foreign=foreign, overwrite=overwrite, **given)


def _write_feed(paths: Sequence[Path], *, overwrite: bool) -> None:
    """Write the measurements of a recording as the lines of a feed."""
    from geograph.feed.replay import json_lines
    from geograph.io.atomic import replacing_file

    source, target = paths[0], paths[-1]
    if len(paths) > 2:
        raise InputError(f"{len(paths) - 1} inputs; expected one recording", path=paths[1])
    if target.exists() and not overwrite:
        raise InputError("is there already; give --overwrite, or name another", path=target)
    with replacing_file(target) as draft, draft.open("w", encoding="utf-8") as file:
        file.writelines(json_lines(read(source)))


def per_camera(name: str, texts: Sequence[str]) -> float | dict[str, float]:
    """Return the value for all cameras, or values by camera, with that of all others under "".

    >>> per_camera("clock_offset_s", ["0.5"])
    0.5
    >>> per_camera("clock_offset_s", ["UK000X=5", "DFNEXT065=0.01"])
    {'UK000X': 5.0, 'DFNEXT065': 0.01}
    >>> per_camera("clock_offset_s", ["1", "UK000X=5"])
    {'': 1.0, 'UK000X': 5.0}

    Raises
    ------
    InputError
        If one is not a number, or two are for the same.
    """
    values: dict[str, float] = {}
    for text in texts:
        camera, _, number = text.rpartition("=")
        if camera in values:
            whose = f"camera {camera}" if camera else "all cameras"
            raise InputError(f"{name} is given twice for {whose}; expected one number")
        try:
            values[camera] = float(number)
        except ValueError:
            raise InputError(
                f"{name} is {text!r}; expected a number, or CAMERA=NUMBER for one camera"
            ) from None
    return values[""] if list(values) == [""] else values
