"""Whatever interrupts a run, its output folder is whole: old or new."""

from __future__ import annotations

import errno
import os
import random
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest
from recordings import write_files
from unmeasured import environment

from geograph.errors import InputError
from geograph.io import atomic
from geograph.io.atomic import replacing_file, replacing_folder

if TYPE_CHECKING:
    from pathlib import Path

# For every line read, a child that replaces a folder again and again, each time by files that all
# hold the number of the round, until it is stopped.
WRITER = """
import os, sys
from geograph.io import atomic
if sys.argv[2] == "without exchange":
    atomic._exchange = lambda first, second: False
for line in sys.stdin:
    child = os.fork()
    if child:
        print(child, flush=True)
        os.waitpid(child, 0)
        print("gone", flush=True)
        continue
    try:
        for number in range(1_000_000):
            with atomic.replacing_folder(sys.argv[1]) as staging:
                (staging / "inner").mkdir()
                for name in ("1.txt", "2.txt", "summary.json", "inner/3.txt"):
                    (staging / name).write_text(f"{number} " * 500)
    except KeyboardInterrupt:
        os._exit(0)
"""


def fail_after(_: int) -> None:
    """Raise, whatever was done before."""
    raise ZeroDivisionError


def round_in(folder: Path) -> str:
    """Return the number that all files of a folder hold, after checking that all are there."""
    texts = {path.name: path.read_text() for path in folder.rglob("*") if path.is_file()}
    assert sorted(texts) == ["1.txt", "2.txt", "3.txt", "summary.json"]
    (words,) = {tuple(text.split()) for text in texts.values()}
    assert len(words) == 500
    (number,) = set(words)
    return number


@pytest.mark.parametrize("way", ["exchange", "without exchange"])
@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT])
def test_stopped_at_any_moment(tmp_path: Path, way: str, stop: signal.Signals) -> None:
    rng = random.Random(f"{way} {stop}")
    target = tmp_path / "results"
    seen = []
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(target), way],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
        env=environment(),
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for _ in range(25):
            process.stdin.write("go\n")
            child = int(process.stdout.readline())
            time.sleep(rng.uniform(0.0, 0.1))
            os.kill(child, stop)
            assert process.stdout.readline() == "gone\n"
            if way == "without exchange":
                # For a moment there is only the old content beside; the next run puts it back.
                atomic._tidy(target)
            if target.exists() or seen:
                seen.append(round_in(target))
        process.stdin.close()
    assert len(seen) > 10
    with replacing_folder(target) as staging:
        (staging / "summary.json").write_text("last")
    assert [entry.name for entry in tmp_path.iterdir()] == ["results"]
    # What is not geograph's stays.
    assert sorted(entry.name for entry in target.iterdir()) == [
        "1.txt", "2.txt", "inner", "summary.json"
    ]  # fmt: skip
    assert (target / "summary.json").read_text() == "last"


def test_other_files_are_carried_over(tmp_path: Path) -> None:
    target = write_files(
        tmp_path / "out", {"summary.json": "old", "path.png": "old", "notes.txt": "mine"}
    )
    (target / "deeper").mkdir()
    (target / "deeper" / "more.csv").write_text("mine")
    with replacing_folder(target) as staging:
        (staging / "summary.json").write_text("new")
    assert (target / "summary.json").read_text() == "new"
    assert (target / "notes.txt").read_text() == "mine"
    assert (target / "deeper" / "more.csv").read_text() == "mine"
    # A picture of the earlier run does not belong to the new one.
    assert not (target / "path.png").exists()


def test_error_leaves_the_old_content(tmp_path: Path) -> None:
    target = write_files(tmp_path / "out", {"summary.json": "old"})
    with pytest.raises(ZeroDivisionError), replacing_folder(target) as staging:
        fail_after((staging / "summary.json").write_text("new"))
    assert (target / "summary.json").read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_a_full_disk_is_named_by_the_folder(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="nothing of this result was written") as caught:  # noqa: SIM117
        with replacing_folder(tmp_path / "out"):
            raise OSError(errno.ENOSPC, "No space left on device")
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(tmp_path / "out"))
    assert list(tmp_path.iterdir()) == []


def test_leftovers_are_tidied_without_a_new_run(tmp_path: Path) -> None:
    atomic.tidy(tmp_path / "no" / "out")
    (tmp_path / ".out.geograph-new-0123456789ab").mkdir()
    (tmp_path / ".other.geograph-new-0123456789ab").mkdir()
    atomic.tidy(tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == [".other.geograph-new-0123456789ab"]


def test_new_nested_and_empty_targets(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir(mode=0o750)
    for target in (tmp_path / "a" / "b", tmp_path / "empty"):
        with replacing_folder(target) as staging:
            (staging / "x").write_text("new")
        assert (target / "x").read_text() == "new"
    assert (tmp_path / "empty").stat().st_mode & 0o777 == 0o750


@pytest.mark.parametrize(
    ("files", "markers", "message"),
    [
        ({"thesis.tex": ""}, ("summary.json",), "holds other files ('thesis.tex')"),
        ({"recording.toml": ""}, ("summary.json",), "is a recording and is not overwritten"),
        (
            {"recording.toml": "", "summary.json": ""},
            ("summary.json",),
            "is a recording and is not overwritten",
        ),
        ({"summary.json": ""}, ("recording.toml",), "holds other files ('summary.json')"),
    ],
)
def test_foreign_folders_are_left_alone(
    tmp_path: Path, files: dict[str, str], markers: tuple[str, ...], message: str
) -> None:
    target = write_files(tmp_path / "mine", files)
    with pytest.raises(InputError) as caught, replacing_folder(target, markers=markers):
        pytest.fail("the block was entered")
    assert message in str(caught.value)
    assert sorted(entry.name for entry in target.iterdir()) == sorted(files)


def test_foreign_files_that_come_meanwhile_are_left_alone(tmp_path: Path) -> None:
    target = tmp_path / "mine"
    with pytest.raises(InputError, match="holds other files"), replacing_folder(target):
        write_files(target, {"thesis.tex": "precious"})
    assert (target / "thesis.tex").read_text() == "precious"


def test_target_that_cannot_be(tmp_path: Path) -> None:
    write_files(tmp_path, {"file": "x"})
    for target, message in (
        (tmp_path / "file", "is a file; expected a folder"),
        (tmp_path / "file" / "below", "cannot be written"),
        (tmp_path / ("x" * 300), "cannot be opened .File name too long"),
        (tmp_path / "a\0b", "cannot be written"),
    ):
        with pytest.raises(InputError, match=message), replacing_folder(target):
            pytest.fail("the block was entered")


def test_a_link_keeps_pointing_to_the_folder(tmp_path: Path) -> None:
    write_files(tmp_path / "real", {"summary.json": "old"})
    (tmp_path / "link").symlink_to("real")
    with replacing_folder(tmp_path / "link") as staging:
        (staging / "summary.json").write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "summary.json").read_text() == "new"


def test_staging_of_a_living_run_is_left_alone(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with replacing_folder(target) as ours:
        (ours / "summary.json").write_text("ours")
        with replacing_folder(target) as theirs:
            (theirs / "summary.json").write_text("theirs")
        assert (target / "summary.json").read_text() == "theirs"
        assert (ours / "summary.json").read_text() == "ours"
    assert (target / "summary.json").read_text() == "ours"
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("moved", [True, False])
def test_old_content_moved_away_is_put_back(tmp_path: Path, moved: bool) -> None:
    target = tmp_path / "out"
    write_files(tmp_path / ".out.geograph-old-0123456789ab", {"summary.json": "old"})
    if not moved:
        write_files(target, {"summary.json": "newer"})
    with pytest.raises(ZeroDivisionError), replacing_folder(target):
        raise ZeroDivisionError
    assert (target / "summary.json").read_text() == ("old" if moved else "newer")
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_files_are_replaced_whole(tmp_path: Path) -> None:
    target = tmp_path / "a.zip"
    with replacing_file(target) as staging:
        staging.write_text("one")
    with pytest.raises(ZeroDivisionError), replacing_file(target) as staging:
        fail_after(staging.write_text("two"))
    assert target.read_text() == "one"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.zip"]
    with pytest.raises(InputError, match="is a folder"), replacing_file(tmp_path):
        pytest.fail("the block was entered")
