"""Real recordings that come with the package.

An example is one recording, or a set of recordings that belong together: then its folder holds them
in ``recordings``, beside the original files.
"""

from __future__ import annotations

import shutil
from importlib import resources
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.io.atomic import RECORDING_MARKERS, check_replaceable, replacing_folder

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable
    from pathlib import Path

_HEADER = "recording.toml"
_SET = "recordings"
_ABOUT = "README.md"


def titles() -> dict[str, str]:
    """Return what each example is, by its name.

    It is the first line of a recording's header, a comment, or of what a set has as README.
    """
    found = {}
    for folder in sorted(_data().iterdir(), key=lambda entry: entry.name):
        about = folder / (_ABOUT if (folder / _SET).is_dir() else _HEADER)
        if about.is_file():
            first = about.read_text(encoding="utf-8").lstrip().splitlines()[0]
            found[folder.name] = first.lstrip("# ") if first.startswith("#") else ""
    return found


def write_example(name: str, folder: Path) -> list[Path]:
    """Write an example into a folder.

    A single recording is written whole or not at all, and so is each of a set, of which the folder
    then holds one folder for each.

    Parameters
    ----------
    name
        One of :func:`titles`.
    folder
        Made if absent. A recording of the same name is replaced.

    Returns
    -------
    list of Path
        The recordings' folders: ``folder`` itself, or those in it.

    Raises
    ------
    InputError
        If there is no such example, or a folder to be written holds something else; then nothing
        is written.
    """
    known = titles()
    if name not in known:
        raise InputError(f"unknown example {name!r}; expected one of {', '.join(known)}")
    with resources.as_file(_data() / name) as source:
        together = source / _SET
        if not together.is_dir():
            _copy(source, folder)
            return [folder]
        if (folder / _HEADER).exists():
            raise InputError(
                f"is a recording, and example {name!r} is a set of them; name another folder",
                path=folder,
            )
        pairs = [(entry, folder / entry.name) for entry in sorted(together.iterdir())]
        for _, target in pairs:
            check_replaceable(target, markers=RECORDING_MARKERS)
        for entry, target in pairs:
            _copy(entry, target)
    return [target for _, target in pairs]


def _copy(source: Path, target: Path) -> None:
    with replacing_folder(target, markers=RECORDING_MARKERS) as fresh:
        shutil.copytree(source, fresh, dirs_exist_ok=True)


def _data() -> Traversable:
    # By its path: geograph itself imports nothing from the scenarios.
    return resources.files("geograph") / "scenarios" / "data"
