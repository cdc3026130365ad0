"""The command line: exit statuses, messages in one line, tables, and what is written."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
from made_track import make_track
from small_recordings import write_small

import geograph
from geograph.cli import main, names
from geograph.errors import SolveError
from geograph.plot import PICTURES
from geograph.recording import LossName, MotionName, SmoothSettings

COMMANDS = (
    "smooth",
    "bound",
    "example",
    "simulate",
    "montecarlo",
    "convert",
    "plot",
    "compare",
    "track",
    "doctor",
    "report",
)


def run(*arguments, **options):
    """Run the command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "geograph", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        **options,
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_small(tmp_path_factory.mktemp("cli") / "small")


def test_smooth_writes_results_and_prints_a_table(recording, tmp_path, capsys):
    assert main(["smooth", str(recording), "-o", str(tmp_path / "out")]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("small: converged in ")
    assert "\x1b" not in out
    lines = out.splitlines()
    assert re.search(r"chi2/dof [\d.]+/\d+, 120 measurements over 9\.75 s, 0 rejected", lines[0])
    for label in ("start ", "middle ", "end "):
        assert any(line.startswith(label) for line in lines)
    assert any(re.match(r"A +40 +0 +[\d.]+ .*±", line) for line in lines)
    assert lines[-1] == f"written to {tmp_path / 'out'}"
    tables = {"track.csv", "sensors.csv", "residuals.csv", "summary.json", "truth.csv"}
    tables |= {"sensor_positions.csv", *PICTURES}
    assert {path.name for path in (tmp_path / "out").iterdir()} == tables


def test_flags_override_the_settings_of_the_recording(recording, tmp_path):
    flags = {
        "--motion": "constant-acceleration",
        "--process-noise": "0.3,0.4,0.5",
        "--spacing": "1.5",
        "--loss": "huber",
        "--max-iterations": "77",
    }
    arguments = ["--no-plots", *(word for pair in flags.items() for word in pair)]
    assert main(["smooth", str(recording), "-o", str(tmp_path / "out"), *arguments]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    settings = summary["settings"]
    assert settings["motion"] == "constant-acceleration"
    assert settings["process_noise"] == [0.3, 0.4, 0.5]
    assert settings["spacing_s"] == pytest.approx(1.5, rel=0.2)
    assert (settings["loss"], settings["max_iterations"]) == ("huber", 77)
    assert not list((tmp_path / "out").glob("*.png"))
    assert summary["command"].startswith(f"geograph smooth {recording} -o ")


def test_every_setting_has_a_flag_and_every_name_is_in_the_help():
    text = run("smooth", "--help", env=os.environ | {"COLUMNS": "200"}).stdout
    for field in dataclasses.fields(SmoothSettings):
        flag = "--" + field.name.removesuffix("_s").replace("_", "-")
        assert flag in text
    for name in (*get_args(MotionName), *get_args(LossName)):
        assert name in text


def test_noise_along_the_velocity_needs_noise_across_it(recording, tmp_path, capsys):
    target = tmp_path / "out"
    arguments = ["--process-noise", "auto", "--process-noise-along", "5"]
    assert main(["smooth", str(recording), "-o", str(target), *arguments]) == 2
    assert "process_noise_along needs one number" in capsys.readouterr().err
    assert not target.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["smooth", "none", "-o", "out"], "none: no such file or folder"),
        (["smooth", "{rec}"], "Missing option '--output' / '-o'"),
        (["smooth", "{rec}", "-o", "out", "--motion", "warp"], "unknown motion 'warp'; expected"),
        (["smooth", "{rec}", "-o", "out", "--loss", "l1"], "unknown loss 'l1'; expected one of"),
        (["smooth", "{rec}", "-o", "out", "--process-noise", "big"], "--process-noise is 'big'"),
        (["smooth", "{rec}", "-o", "out", "--process-noise", "-1"], "expected a finite number"),
        (["smooth", "{rec}", "-o", "out", "--spacing", "0"], "spacing_s is 0.0; expected"),
        (["smooth", "{rec}", "-o", "out", "--max-iterations", "x"], "--max-iterations"),
        (["smooth", "{rec}", "-o", "{rec}"], "is a recording and is not overwritten"),
        (["smooth", "{rec}", "-o", "{rec}/bearings.csv"], "is a file; expected a folder"),
        (["example", "atlantis", "-o", "out"], "unknown example 'atlantis'; expected one of"),
        (["example"], "expected a name and -o DIR"),
        (["convert", "one"], "expected one input or more"),
        (["convert", "{rec}", "out", "--sigma", "a=b"], "sigma_deg is 'a=b'; expected a number"),
        (["convert", "{rec}", "out", "--sigma", "1", "--sigma", "2"], "twice for all cameras"),
        (["convert", "{rec}", "out", "--bias", "a=1", "--bias", "a=2"], "twice for camera a"),
        (["plot", "{rec}"], "summary.json: cannot be read"),
        (["compare", "{rec}", "{rec}"], "track.csv: cannot be read"),
        (["fly"], "No such command 'fly'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_input_is_one_line_with_status_2_and_nothing_is_written(
    recording, tmp_path, monkeypatch, capsys, *, arguments, message
):
    monkeypatch.chdir(tmp_path)
    before = sorted(recording.iterdir())
    status = main([word.replace("{rec}", str(recording)) for word in arguments])
    out, err = capsys.readouterr()
    assert (status, out) == (2, "")
    assert err.startswith("geograph: error: ")
    assert message in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
    assert sorted(recording.iterdir()) == before


def test_bad_cell_is_named_by_file_line_and_column(tmp_path, capsys):
    folder = write_small(tmp_path / "rec")
    table = folder / "bearings.csv"
    lines = table.read_text().splitlines()
    lines[6] = lines[6].rsplit(",", 1)[0] + ",-1"
    table.write_text("\n".join(lines))
    assert main(["smooth", str(folder), "-o", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"geograph: error: {table}:7, column sigma_deg: ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("status", ["unobservable", "iteration_limit", "diverged"])
def test_what_did_not_converge_is_written_marked_with_status_3(
    recording, tmp_path, monkeypatch, capsys, status
):
    monkeypatch.setattr(geograph, "smooth", lambda *_, **__: make_track(status=status))
    assert main(["smooth", str(recording), "-o", str(tmp_path / "out"), "--no-plots"]) == 3
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["status"] == status
    out = capsys.readouterr().out
    assert f"made: {status.replace('_', ' ')} in" in out
    # The clock of CAM01 is 3.6 prior sigmas off.
    assert re.search(r"CAM01 .*\+3\.6 ± 0\.02 !", out)
    assert "! further than 3 prior sigmas from zero" in out
    assert "CAM01 clock_offset is 3.6 prior sigmas from zero" in out


def test_solver_without_any_estimate_gives_status_3(recording, tmp_path, monkeypatch, capsys):
    def fail(*_, **__):
        raise SolveError("no start was found", status="diverged")

    monkeypatch.setattr(geograph, "smooth", fail)
    assert main(["smooth", str(recording), "-o", str(tmp_path / "out")]) == 3
    assert capsys.readouterr().err == "geograph: small: diverged: no start was found\n"
    assert not (tmp_path / "out").exists()


def test_a_defect_does_not_look_like_bad_input(recording, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(geograph, "smooth", fail)
    with pytest.raises(ZeroDivisionError):
        main(["smooth", str(recording), "-o", str(tmp_path / "out")])


def test_interruption_is_quiet_with_status_130(recording, tmp_path, monkeypatch, capsys):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(geograph, "smooth", stop)
    assert main(["smooth", str(recording), "-o", str(tmp_path / "out")]) == 130
    assert capsys.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_said_in_one_line_with_status_1(recording, tmp_path, monkeypatch, capsys):
    def full(*_, **__):
        raise OSError(28, "No space left on device", "track.csv")

    monkeypatch.setattr(geograph, "smooth", full)
    assert main(["smooth", str(recording), "-o", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err == "geograph: error: track.csv: No space left on device\n"


def test_a_closed_pipe_is_quiet():
    shell = f"{sys.executable} -m geograph smooth --help | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, check=False)
    assert done.stderr == ""


def test_several_recordings_make_a_table_and_the_worst_is_the_status(tmp_path, capsys):
    good = [write_small(tmp_path / f"pass{i}", seed=i) for i in range(2)]
    arguments = ["smooth", *map(str, good), "-o", str(tmp_path / "out"), "--no-plots"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert f"2 of 2 converged; written to {tmp_path / 'out'}" in out
    arguments.insert(2, str(tmp_path / "absent"))
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert err.count("\n") == 1
    assert err.startswith("geograph: error: ")
    assert "absent: no such file or folder" in err
    # What went wrong stands first.
    assert out.splitlines()[1].startswith("absent")
    assert "2 of 3 converged" in out


def test_plot_draws_again_from_the_files_alone(recording, tmp_path, capsys):
    main(["smooth", str(recording), "-o", str(tmp_path / "out"), "--no-plots"])
    capsys.readouterr()
    assert main(["plot", str(tmp_path / "out")]) == 0
    drawn = capsys.readouterr().out.split()
    assert sorted(drawn) == sorted(str(tmp_path / "out" / name) for name in PICTURES)
    assert all(Path(path).exists() for path in drawn)


def test_compare_prints_a_table_or_json(recording, tmp_path, capsys):
    out = tmp_path / "out"
    main(["smooth", str(recording), "-o", str(out), "--no-plots"])
    capsys.readouterr()
    assert main(["compare", str(out), str(recording)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("10 points of the truth\n")
    assert re.search(r"^position \(m\) +[\d.]+", text, re.MULTILINE)
    assert "NEES: mean" in text
    assert main(["compare", str(out / "track.csv"), str(recording / "truth.csv"), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    # 0.01 degrees at 2 km is 0.35 m for one bearing of 240.
    assert 0.0 < figures["position_m"]["rmse"] < 0.35
    assert 0.07 < figures["nees"]["mean"] < 12.8


def test_convert_rewrites_a_recording(recording, tmp_path, capsys):
    assert main(["convert", str(recording), str(tmp_path / "other"), "--parquet"]) == 0
    assert capsys.readouterr().out == f"wrote {tmp_path / 'other'}\n"
    again = geograph.read(tmp_path / "other")
    assert (tmp_path / "other" / "bearings.parquet").exists()
    first = geograph.read(recording).bearings
    assert again.bearings.azimuth_rad.tolist() == pytest.approx(first.azimuth_rad.tolist())


def test_version_names_what_computes():
    done = run("--version")
    pattern = (
        r"geograph \S+ \(Python \S+, \S+; kernels (compiled|NumPy alone)\)\n"
        r"needs: gtsam \S+, matplotlib \S+, numpy \S+, pandas \S+, pyproj \S+, rich \S+, "
        r"scipy \S+, threadpoolctl \S+, typer \S+\nextras: .+\n"
    )
    assert done.returncode == 0
    assert re.fullmatch(pattern, done.stdout), done.stdout


def test_shells_complete_names(monkeypatch):
    monkeypatch.setenv("COMP_WORDS", "geograph smooth x --motion orb")
    monkeypatch.setenv("COMP_CWORD", "4")
    monkeypatch.setenv("_GEOGRAPH_COMPLETE", "complete_bash")
    assert run().stdout.split() == ["orbital"]
    assert names.example_names("win") == ["winchcombe"]
    assert names.scenario_names("low-o") == ["low-orbit"]
    assert names.one_of("format")("map") == ["mapped"]
    assert names.one_of("loss")("g") == ["geman-mcclure", "gnc"]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command):
    done = run(command, "--help")
    assert done.returncode == 0
    assert "Usage: geograph " + command in done.stdout


def test_without_arguments_the_commands_are_shown():
    done = run()
    assert all(command in done.stdout + done.stderr for command in COMMANDS)


def test_help_needs_no_heavy_library():
    program = (
        "import sys\n"
        "from geograph.cli import main, names\n"
        "try:\n"
        "    main(['--help'])\n"
        "except SystemExit:\n"
        "    pass\n"
        "heavy = {'gtsam', 'scipy', 'pandas', 'matplotlib', 'pyproj', 'astropy', 'pyarrow'}\n"
        "sys.exit(', '.join(sorted(heavy & set(sys.modules))) or 0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "smooth" in done.stdout


def test_the_batch_engine_does_without_gtsam():
    """Which takes a seventh of a second to load."""
    code = "import sys, geograph.smoother; sys.exit('gtsam' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def on_terminal(*arguments):
    """Run the command on a pseudo-terminal and return what it showed."""
    here, there = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "geograph", *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=there,
        stderr=there,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "120"},
    )
    os.close(there)
    shown = b""
    # Reading ends in an error when the other end is closed.
    with contextlib.suppress(OSError):
        while part := os.read(here, 65536):
            shown += part
    os.close(here)
    assert process.wait() == 0
    return shown.decode()


def test_on_a_terminal_there_is_colour_and_progress(recording, tmp_path):
    shown = on_terminal("smooth", recording, "-o", tmp_path / "one", "--no-plots")
    assert "smoothing " in shown
    assert "\x1b[32mconverged\x1b[0m" in shown
    shown = on_terminal("smooth", recording, recording, "-o", tmp_path / "two", "--no-plots")
    assert "2/2" in shown
    assert "2 of 2 converged" in shown


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from geograph.cli import main, names; main(['--help']);"
        "heavy = {'gtsam', 'scipy', 'pandas', 'matplotlib', 'pyproj', 'astropy', 'pyarrow'};"
        "assert not heavy.intersection(sys.modules), heavy.intersection(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_convert_writes_a_feed(recording, tmp_path, capsys):
    target = tmp_path / "feed.jsonl"
    assert main(["convert", str(recording), str(target)]) == 0
    assert capsys.readouterr().out == f"wrote {target}\n"
    rows = [json.loads(line) for line in target.read_text().splitlines()]
    assert len(rows) == 120
    assert list(rows[0]) == ["time_s", "sensor", "azimuth_deg", "elevation_deg", "sigma_deg"]
    assert main(["convert", str(recording), str(target)]) == 2
    assert "is there already; give --overwrite" in capsys.readouterr().err
    assert main(["convert", str(recording), str(recording), str(target), "--overwrite"]) == 2
    assert "2 inputs; expected one recording" in capsys.readouterr().err
    assert main(["convert", str(recording), str(target), "--overwrite"]) == 0
