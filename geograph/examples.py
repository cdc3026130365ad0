"""Real recordings that come with the package."""

from __future__ import annotations

import shutil
from importlib import resources
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.io.atomic import RECORDING_MARKERS, replacing_folder

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable
    from pathlib import Path

_HEADER = "recording.toml"


def titles() -> dict[str, str]:
    """Return what each shipped recording is, by its name: the first comment of its header."""
    found = {}
    for folder in sorted(_data().iterdir(), key=lambda entry: entry.name):
        header = folder / _HEADER
        if header.is_file():
            first = header.read_text(encoding="utf-8").lstrip().splitlines()[0]
            found[folder.name] = first.lstrip("# ") if first.startswith("#") else ""
    return found


def write_example(name: str, folder: Path) -> None:
    """Write a shipped recording into a folder.

    Parameters
    ----------
    name
        One of :func:`titles`.
    folder
        Made if absent, replaced if it holds a recording.

    Raises
    ------
    InputError
        If there is no such recording, or the folder holds something else.
    """
    known = titles()
    if name not in known:
        raise InputError(f"unknown example {name!r}; expected one of {', '.join(known)}")
    with (
        replacing_folder(folder, markers=RECORDING_MARKERS) as fresh,
        resources.as_file(_data() / name) as source,
    ):
        shutil.copytree(source, fresh, dirs_exist_ok=True)


def _data() -> Traversable:
    # By its path: geograph itself imports nothing from the scenarios.
    return resources.files("geograph") / "scenarios" / "data"
