"""Where a recording's files come from: a folder, or a zip archive of one."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Protocol

from geograph.errors import InputError
from geograph.io.messages import shown

if TYPE_CHECKING:
    from collections.abc import Iterator

HEADER_NAME = "recording.toml"

FOREIGN_SUFFIXES = {
    ".ecsv": "ecsv",
    ".tdm": "tdm",
    ".kvn": "tdm",
    ".xml": "tdm",
    ".iod": "iod",
    ".uk": "uk",
    ".mpc": "mpc",
    ".obs": "mpc",
}
"""Files of other formats that are read, with their formats."""


class Source(Protocol):
    """Files of one recording, by name."""

    @property
    def path(self) -> Path:
        """Return the path of the folder or archive."""

    @property
    def name(self) -> str:
        """Return the name of the recording."""

    def names(self) -> list[str]:
        """Return the names of the files at the top, sorted."""

    def has(self, name: str) -> bool:
        """Return whether there is a file (or anything else) of that name."""

    def place(self, name: str) -> Path:
        """Return how a file is called in messages."""

    def read_bytes(self, name: str) -> bytes:
        """Return a file's content; raises InputError if it cannot be read."""

    def raster_location(self, name: str) -> str:
        """Return what GDAL opens to read a file by window."""


class FolderSource:
    """A recording in a folder."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = path.resolve().name or "recording"

    def names(self) -> list[str]:
        """Return the names of the files at the top, sorted."""
        try:
            return sorted(entry.name for entry in self.path.iterdir())
        except OSError as error:
            raise InputError(f"cannot be listed ({error.strerror})", path=self.path) from None

    def has(self, name: str) -> bool:
        """Return whether there is a file (or anything else) of that name."""
        return os.path.lexists(self.path / name)

    def place(self, name: str) -> Path:
        """Return how a file is called in messages."""
        return self.path / name

    def read_bytes(self, name: str) -> bytes:
        """Return a file's content; raises InputError if it cannot be read."""
        return read_file(self.path / name)

    def raster_location(self, name: str) -> str:
        """Return what GDAL opens to read a file by window."""
        return str((self.path / name).absolute())


class ZipSource:
    """A recording in a zip archive, its files at the root or in one folder.

    Nothing is unpacked to disk: members are read into memory, and members whose names point out of
    the archive make it invalid as a whole.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = path.stem
        with self._open() as archive:
            infos = [info for info in archive.infolist() if not info.is_dir()]
        for info in infos:
            _check_member(path, info)
        headers = [
            PurePosixPath(info.filename)
            for info in infos
            if PurePosixPath(info.filename).name == HEADER_NAME
            and len(PurePosixPath(info.filename).parts) <= 2
            and not info.filename.startswith("__MACOSX/")
        ]
        if len(headers) != 1:
            raise InputError(
                f"holds {len(headers)} files {HEADER_NAME} at its root or in one folder; "
                "expected one; zip the folder of one recording",
                path=path,
            )
        self._root = headers[0].parent
        self._members = {info.filename for info in infos}

    def names(self) -> list[str]:
        """Return the names of the files at the top, sorted."""
        members = (PurePosixPath(name) for name in self._members)
        return sorted(member.name for member in members if member.parent == self._root)

    def has(self, name: str) -> bool:
        """Return whether there is a file of that name."""
        return str(self._root / name) in self._members

    def place(self, name: str) -> Path:
        """Return how a file is called in messages."""
        return self.path / self._root / name

    def read_bytes(self, name: str) -> bytes:
        """Return a file's content; raises InputError if it cannot be read."""
        if not self.has(name):
            raise InputError("no such file in the archive", path=self.place(name))
        with self._open() as archive:
            try:
                return archive.read(str(self._root / name))
            # Damaged members end in errors of several libraries: zlib, lzma, bz2, struct.
            except Exception as error:
                raise InputError(
                    f"cannot be unpacked ({str(error)[:120]}); expected a whole zip archive; "
                    "make it again",
                    path=self.place(name),
                ) from None

    def raster_location(self, name: str) -> str:
        """Return what GDAL opens to read a file by window."""
        return f"/vsizip/{{{self.path.absolute()}}}/{self._root / name}"

    def _open(self) -> zipfile.ZipFile:
        try:
            return zipfile.ZipFile(self.path)
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror})", path=self.path) from None
        # Broken directories also end in UnicodeDecodeError, struct.error, OverflowError and others.
        except Exception as error:
            raise InputError(
                f"is not a zip archive ({str(error)[:120]}); expected a recording's folder, or a "
                ".zip of one",
                path=self.path,
            ) from None


def _check_member(path: Path, info: zipfile.ZipInfo) -> None:
    parts = PurePosixPath(info.filename.replace("\\", "/")).parts
    if ".." in parts or info.filename.startswith(("/", "\\")) or ":" in (parts or ("",))[0]:
        raise InputError(
            f"member {shown(info.filename)} points out of the archive; "
            "expected plain relative names; make it again",
            path=path,
        )
    if info.flag_bits & 0x1:
        raise InputError(
            f"member {shown(info.filename)} is encrypted; expected a plain archive; unpack it "
            "first",
            path=path,
        )


def open_source(path: Path | str) -> Source:
    """Return the source at a path: a folder, or a file that is a zip archive.

    Raises
    ------
    InputError
        If there is nothing, or something else.
    """
    place = Path(path)
    try:
        if place.is_dir():
            return FolderSource(place)
        exists = place.exists()
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"cannot be opened ({str(error)[:120]})", path=shown(str(path))) from None
    if not exists:
        raise InputError(
            "no such file or folder; expected a recording's folder, or a .zip of one", path=place
        )
    if not place.is_file():
        raise InputError(
            "is not a regular file; expected a recording's folder, or a .zip of one", path=place
        )
    if place.suffix.lower() in FOREIGN_SUFFIXES:
        raise InputError(
            "is a file of another format; expected a recording's folder, or a .zip; make one "
            "first (geograph convert)",
            path=place,
        )
    if place.name == HEADER_NAME:
        raise InputError(
            f"is a recording's header; expected its folder; give {place.parent}", path=place
        )
    return ZipSource(place)


def read_file(path: Path) -> bytes:
    """Return a file's bytes; raises InputError if it is missing, a folder, or unreadable."""
    if path.is_dir():
        raise InputError("is a folder; expected a file", path=path)
    # A pipe would wait for a writer for ever.
    if path.exists() and not path.is_file():
        raise InputError("is not a regular file; expected a file", path=path)
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", path=path) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", path=path) from None


def decode(content: bytes, place: Path) -> str:
    """Return the text of a UTF-8 file, without its byte order mark.

    Raises
    ------
    InputError
        With the line of the first byte that is not UTF-8.
    """
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        # The decoder counts from after the byte order mark; it is on line 1 in either case.
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(
            f"byte 0x{error.object[error.start]:02x} is not UTF-8; expected text in UTF-8; save "
            "the file in that encoding",
            path=place,
            line=line,
        ) from None


def numbered(name: str) -> Iterator[str]:
    """Yield a name, then the name with _2, _3 and so on, for names that must differ."""
    yield name
    number = 2
    while True:
        yield f"{name}_{number}"
        number += 1
