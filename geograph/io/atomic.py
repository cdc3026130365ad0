"""Folders that are replaced whole or not at all.

New content is written into a staging folder beside the target, forced to disk, and put in place by
one exchange of names (``renameat2`` on Linux, ``renamex_np`` on macOS), so that whoever looks, at
any moment and after any crash, finds the old content whole or the new content whole.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import secrets
import shutil
import sys
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from geograph.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

RESULT_MARKERS = ("summary.json", "batch.csv")
"""Files by which a folder of results is known to be geograph's own."""

RECORDING_MARKERS = ("recording.toml",)
"""File by which a folder is known to be a recording."""

RESULT_FILES = ("*.csv", "*.png", "summary.json")
"""Files of a results folder that a new run replaces; all others stay."""

RECORDING_FILES = ("recording.toml", "*.csv", "*.parquet", "*.tif", "*.tiff")
"""Files of a recording that writing it anew replaces; all others stay."""

_AT_FDCWD = -100
_RENAME_EXCHANGE_LINUX = 2
_RENAME_SWAP_MACOS = 2
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def replacing_folder(
    target: Path | str,
    *,
    markers: Sequence[str] = RESULT_MARKERS,
    own: Sequence[str] = RESULT_FILES,
) -> Iterator[Path]:
    """Give a folder to write into, which becomes ``target`` when the block ends well.

    When the block raises (Ctrl-C included) the target stays as it was. When the process is killed,
    the target is whole, old or new; what a killed run left beside it is removed by the next run.

    Parameters
    ----------
    target
        The folder to create or to replace. Missing parents are created.
    markers
        An existing folder is replaced only if it is empty or holds one of these files at its top;
        a folder of recordings is never taken for results.
    own
        Patterns of the names that belong to geograph. What else an existing folder holds, notes or
        a licence, is carried over.

    Yields
    ------
    Path
        The staging folder, empty, on the target's file system.

    Raises
    ------
    InputError
        If the target is not a folder, holds files that are not geograph's, or cannot be written.
    """
    with _as_input_error(target):
        # Through a symbolic link the folder behind it is meant, not the link.
        folder = Path(target).resolve()
        folder.parent.mkdir(parents=True, exist_ok=True)
        _tidy(folder)
        check_replaceable(folder, markers=markers, shown=target)
        staging, lock = _make_staging(folder)
    try:
        with _naming(target):
            yield staging
        with _as_input_error(target):
            if folder.exists():
                shutil.copymode(folder, staging)
                _carry_over(folder, staging, own)
            _sync_tree(staging)
            check_replaceable(folder, markers=markers, shown=target)
            _put_in_place(staging, folder)
            _sync(folder.parent)
    finally:
        # After an exchange this is the old content; after an error what was written of the new.
        try:
            _remove(staging)
        finally:
            os.close(lock)


def _carry_over(folder: Path, staging: Path, own: Sequence[str]) -> None:
    """Copy what is not geograph's from the old folder to the new one."""
    for entry in folder.iterdir():
        kept = staging / entry.name
        if kept.exists() or (
            entry.is_file() and any(fnmatch(entry.name, pattern) for pattern in own)
        ):
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.copytree(entry, kept, symlinks=True)
        else:
            shutil.copy2(entry, kept, follow_symlinks=False)


def check_replaceable(
    target: Path | str,
    *,
    markers: Sequence[str] = RESULT_MARKERS,
    shown: Path | str | None = None,
) -> None:
    """Raise InputError if a folder may not be replaced, so that long work need not be begun.

    Parameters
    ----------
    target
        The folder, which need not exist.
    markers
        Files by which its content is known to be replaceable.
    shown
        How the folder is called in the message; itself by default.
    """
    folder = Path(target)
    name = target if shown is None else shown
    try:
        present = {entry.name for entry in folder.iterdir()}
    except FileNotFoundError:
        return
    except NotADirectoryError:
        raise InputError("is a file; expected a folder to write; name another", path=name) from None
    except OSError as error:
        raise InputError(f"cannot be opened ({error.strerror})", path=name) from None
    if not present:
        return
    # Results written onto their own recording would destroy it.
    is_recording = bool(present.intersection(RECORDING_MARKERS))
    if not present.intersection(markers) or (
        is_recording and not set(markers).intersection(RECORDING_MARKERS)
    ):
        what = "is a recording" if is_recording else f"holds other files ({min(present)!r})"
        earlier = f", or one that holds {' or '.join(markers)} of an earlier run" if markers else ""
        raise InputError(
            f"{what} and is not overwritten; expected a new or empty folder{earlier}; name another"
            + ("" if markers else ", or allow to overwrite"),
            path=name,
        )


def tidy(folder: Path) -> None:
    """Remove what ended runs left beside a folder, and what they moved away put back.

    Parameters
    ----------
    folder
        That was to be replaced; it need not be there.
    """
    if folder.parent.is_dir():
        _tidy(folder.resolve())


@contextmanager
def _naming(target: Path | str) -> Iterator[None]:
    """Name the folder where a disk is full: writing does not say what it wrote to."""
    try:
        yield
    except OSError as error:
        if error.errno not in _NO_SPACE:
            raise
        reason = f"{error.strerror}; nothing of this result was written"
        raise OSError(error.errno, reason, str(target)) from error


@contextmanager
def _as_input_error(target: Path | str) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        # RuntimeError: a loop of links; ValueError: a null character in the name.
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"cannot be written ({reason}); expected a folder that can be made; "
            "name another or free it",
            path=target,
        ) from error


def _staging_prefix(folder: Path) -> str:
    return f".{folder.name}.geograph-new-"


def _previous_prefix(folder: Path) -> str:
    return f".{folder.name}.geograph-old-"


def _make_staging(folder: Path) -> tuple[Path, int]:
    """Make a staging folder and lock it, so that other runs know that its owner lives."""
    while True:
        staging = folder.parent / (_staging_prefix(folder) + secrets.token_hex(6))
        staging.mkdir()
        with suppress(FileNotFoundError):
            lock = os.open(staging, os.O_RDONLY)
            # Another run may have taken it for a dead one's before the lock was ours.
            if _try_lock(lock) and _is_same(staging, lock):
                return staging, lock
            os.close(lock)


def _is_same(path: Path, descriptor: int) -> bool:
    return os.path.samestat(path.stat(), os.fstat(descriptor))


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            return False
        # A file system without locks: then stale folders are left alone rather than lost.
        return error.errno in (errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS)
    return True


def _tidy(folder: Path) -> None:
    """Undo what a killed run left: restore a folder moved away, remove dead staging folders."""
    for entry in sorted(folder.parent.iterdir()):
        if entry.name.startswith(_previous_prefix(folder)):
            if folder.exists():
                shutil.rmtree(entry, ignore_errors=True)
            else:
                entry.rename(folder)
        elif entry.name.startswith(_staging_prefix(folder)):
            _remove_if_dead(entry)


def _remove_if_dead(staging: Path) -> None:
    try:
        lock = os.open(staging, os.O_RDONLY)
    except OSError:
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(staging, ignore_errors=True)
    except OSError:
        pass  # Its owner lives.
    finally:
        os.close(lock)


def _remove(folder: Path) -> None:
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except KeyboardInterrupt:
        # The user stopped the run just while it tidied up: tidy up, then stop.
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _put_in_place(staging: Path, folder: Path) -> None:
    try:
        # Succeeds where there is nothing, or an empty folder.
        staging.rename(folder)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
    else:
        return
    if _exchange(staging, folder):
        return
    # Without an exchange of names there is a moment with no target; a run killed in it leaves the
    # old content whole beside, and the next run puts it back.
    previous = folder.parent / (_previous_prefix(folder) + secrets.token_hex(6))
    folder.rename(previous)
    try:
        staging.rename(folder)
    except BaseException:
        previous.rename(folder)
        raise
    shutil.rmtree(previous, ignore_errors=True)


def _exchange(first: Path, second: Path) -> bool:
    """Exchange two names in one step; False where the system or file system cannot."""
    library = ctypes.CDLL(None, use_errno=True)
    one, other = os.fsencode(first), os.fsencode(second)
    if sys.platform == "darwin":
        function = getattr(library, "renamex_np", None)
        arguments: tuple[object, ...] = (one, other, ctypes.c_uint(_RENAME_SWAP_MACOS))
    else:
        function = getattr(library, "renameat2", None)
        flags = ctypes.c_uint(_RENAME_EXCHANGE_LINUX)
        arguments = (_AT_FDCWD, one, _AT_FDCWD, other, flags)
    if function is None:
        return False
    if function(*arguments) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP):
        return False
    raise OSError(code, os.strerror(code), str(second))


def _sync_tree(folder: Path) -> None:
    for root, _, files in os.walk(folder):
        for name in files:
            _sync(Path(root) / name)
        _sync(Path(root))


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def replacing_file(target: Path | str) -> Iterator[Path]:
    """Give a new file to write, which becomes ``target`` when the block ends well.

    Parameters
    ----------
    target
        The file to create or to replace. Missing parents are created.

    Yields
    ------
    Path
        A name beside the target that ends in the target's suffix; nothing is there yet.

    Raises
    ------
    InputError
        If the target is a folder or cannot be written.
    """
    with _as_input_error(target):
        file = Path(target).resolve()
        if file.is_dir():
            raise InputError("is a folder; expected a file to write; name another", path=target)
        file.parent.mkdir(parents=True, exist_ok=True)
    staging = file.parent / f".{file.stem}.geograph-{secrets.token_hex(6)}{file.suffix}"
    try:
        yield staging
        with _as_input_error(target):
            _sync(staging)
            staging.replace(file)
            _sync(file.parent)
    finally:
        staging.unlink(missing_ok=True)
