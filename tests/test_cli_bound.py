"""``geograph bound``: what it prints and writes, its exit statuses, and what it refuses."""

from __future__ import annotations

import csv
import json
import os
import pty
import subprocess
import sys

import numpy as np
import pytest
from small_recordings import write_small

import geograph as gg
from geograph.bounds import bound
from geograph.cli import main
from geograph.eliminate import NotPositiveDefiniteError
from geograph.signal import Signal

ARRIVALS = """format = 1
frame = "local"

[sensors.A]
position_m = [0.0, 0.0, 0.0]
[sensors.A.errors]
clock_offset_s = 1e-7
[sensors.B]
position_m = [40000.0, 0.0, 100.0]
[sensors.C]
position_m = [0.0, 40000.0, 500.0]
[sensors.D]
position_m = [30000.0, 30000.0, 0.0]
[sensors.E]
position_m = [20000.0, -9000.0, 800.0]

[smooth]
motion = "static"
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_small(tmp_path_factory.mktemp("cli") / "small")


@pytest.fixture(scope="module")
def radio(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cli") / "radio"
    folder.mkdir()
    (folder / "recording.toml").write_text(ARRIVALS)
    rows = [f"{i},{name},{i},3e-8" for i in range(10) for name in "ABCDE"]
    (folder / "arrivals.csv").write_text("\n".join(["emission,sensor,toa_s,sigma_s", *rows]) + "\n")
    (folder / "truth.csv").write_text("time_s,x_m,y_m,z_m\n0,12000,15000,3000\n")
    return folder


def table(path):
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [row[name] for row in rows] for name in rows[0]}


def numbers(column):
    return np.array([float(value) for value in column])


def test_it_prints_a_table_and_writes_nothing_without_a_folder(recording, capsys):
    before = sorted(recording.iterdir())
    assert main(["bound", str(recording)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "\x1b" not in out
    lines = out.splitlines()
    assert lines[0].startswith("small: Cramer-Rao bound at the true path, constant-velocity, ")
    assert "process noise 1 (as given)" in lines[0]
    assert "120 bearings, sigma 36 arcsec" in lines
    found = bound(gg.read(recording))
    first = next(line for line in lines if line.startswith("0.000 "))
    assert f"{found.sigma_horizontal_m[0]:.4g}" in first.split()
    worst = next(line for line in lines if line.startswith("horizontal (m)")).split()[-1]
    assert worst == f"{found.sigma_horizontal_m.max():.4g}"
    assert any(line.split()[:3] == ["A", "azimuth", "bias"] for line in lines)
    # The ends and some in between, however many knots there are.
    assert sum(line[:1].isdigit() for line in lines) == 12 + 1
    assert sorted(recording.iterdir()) == before


def test_the_folder_holds_tables_a_summary_and_a_picture(recording, tmp_path, capsys):
    target = tmp_path / "out"
    assert main(["bound", str(recording), "-o", str(target)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"written to {target}"
    assert {path.name for path in target.iterdir()} == {"bound.csv", "bound.json", "bound.png"}
    found = bound(gg.read(recording))
    columns = table(target / "bound.csv")
    assert numbers(columns["time_s"]) == pytest.approx(found.time_s)
    assert numbers(columns["sigma_horizontal_m"]) == pytest.approx(found.sigma_horizontal_m)
    for name, values in zip("xyz", found.sigma_axes_m.T, strict=True):
        assert numbers(columns[f"sigma_{name}_m"]) == pytest.approx(values)
    assert numbers(columns["cov_xy_m2"]) == pytest.approx(found.covariance[:, 0, 1])
    assert numbers(columns["semi_major_m"]) == pytest.approx(found.ellipsoids().semi_axes_m[:, 0])
    assert numbers(columns["cep_m"]) == pytest.approx(found.cep_m())
    facts = json.loads((target / "bound.json").read_text())
    assert facts["observable"] is True
    assert facts["evaluated_at"] == "truth"
    assert facts["measurements"] == {"bearings": 120}
    assert facts["sigma_height_m"]["best"] == pytest.approx(found.sigma_height_m.min())
    entry = facts["sensors"]["A"]["azimuth_bias"]
    assert entry["sigma"] == pytest.approx(found.sensor_bounds["A"]["azimuth_bias"].sigma)
    assert facts["command"] == f"geograph bound {recording} -o {target}"
    assert (target / "bound.png").read_bytes().startswith(b"\x89PNG")


def test_an_older_bound_is_replaced_and_notes_stay(recording, tmp_path, capsys):
    target = tmp_path / "out"
    arguments = ["bound", str(recording), "-o", str(target), "--no-plots"]
    assert main([*arguments, "--map", "--cells", "3"]) == 0
    (target / "notes.txt").write_text("mine")
    assert main(arguments) == 0
    names = {path.name for path in target.iterdir()}
    assert names == {"bound.csv", "bound.json", "notes.txt"}
    capsys.readouterr()


def test_a_failure_while_drawing_leaves_the_old_folder_whole(
    recording, tmp_path, monkeypatch, capsys
):
    target = tmp_path / "out"
    assert main(["bound", str(recording), "-o", str(target), "--no-plots"]) == 0
    before = {path.name: path.read_bytes() for path in target.iterdir()}

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("geograph.plot._bound.save_pictures", fail)
    assert main(["bound", str(recording), "-o", str(target), "--motion", "static"]) == 1
    assert {path.name: path.read_bytes() for path in target.iterdir()} == before
    assert "No space left on device" in capsys.readouterr().err


def test_settings_override_those_of_the_recording(recording, tmp_path, capsys):
    flags = ["--motion", "constant-acceleration", "--process-noise", "0.3,0.4,0.5"]
    flags += ["--spacing", "1.5", "--elimination", "gtsam", "--no-plots"]
    assert main(["bound", str(recording), "-o", str(tmp_path / "out"), *flags]) == 0
    settings = json.loads((tmp_path / "out" / "bound.json").read_text())["settings"]
    assert settings["motion"] == "constant-acceleration"
    assert settings["process_noise"] == [0.3, 0.4, 0.5]
    assert settings["spacing_s"] == pytest.approx(1.5, rel=0.2)
    assert settings["elimination"] == "gtsam"
    assert "process noise 0.3,0.4,0.5 (as given)" in capsys.readouterr().out


def test_a_signal_replaces_the_sigmas_and_is_printed(radio, tmp_path, capsys):
    target = tmp_path / "out"
    flags = ["--snr-db", "10", "--band-hz", "433e6", "433.2e6", "--integration-s", "0.01"]
    assert main(["bound", str(radio), "-o", str(target), "--no-plots", *flags]) == 0
    out = capsys.readouterr().out
    signal = Signal(snr_db=10.0, band_hz=(433e6, 433.2e6), integration_s=0.01)
    sigma = signal.arrival_sigma_s()
    assert f"50 arrivals, sigma {sigma * 1e9:.4g} ns" in out
    assert "from 10 dB in 4.33e+08 to 4.332e+08 Hz over 0.01 s, without the phase" in out
    facts = json.loads((target / "bound.json").read_text())
    assert facts["sigmas"]["arrivals"]["sigma_s"]["median"] == pytest.approx(sigma)
    assert facts["signal"]["arrival_sigma_s"] == pytest.approx(sigma)
    assert main(["bound", str(radio), *flags, "--coherent"]) == 0
    assert "with the phase of the carrier" in capsys.readouterr().out
    weak = ["--snr-db", "-60", *flags[2:]]
    main(["bound", str(radio), *weak])
    assert "too weak for any estimator" in capsys.readouterr().out


def test_a_map_is_written_and_summed_up(radio, tmp_path, capsys):
    target = tmp_path / "out"
    flags = ["--map", "--cells", "6", "--extent-m", "60000"]
    assert main(["bound", str(radio), "-o", str(target), *flags]) == 0
    out = capsys.readouterr().out
    assert "map for an emitter that stands still: 6 x 6 cells over 60 km; horizontal" in out
    columns = table(target / "bound_map.csv")
    sigma = numbers(columns["sigma_horizontal_m"])
    assert sigma.size == 36
    assert numbers(columns["x_m"])[:2] == pytest.approx([-13000.0, -3000.0])
    assert set(columns["z_m"]) == {"3000.0"}
    facts = json.loads((target / "bound.json").read_text())["map"]
    assert facts["extent_m"] == pytest.approx(60000.0)
    seen = np.array(columns["not_observable_because"]) == ""
    assert facts["sigma_horizontal_m"]["worst"] == pytest.approx(sigma[seen].max())
    assert (target / "bound_map.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_not_observable_is_named_with_status_3(radio, tmp_path, capsys):
    folder = tmp_path / "two"
    folder.mkdir()
    for name in ("recording.toml", "truth.csv"):
        (folder / name).write_text((radio / name).read_text())
    rows = (radio / "arrivals.csv").read_text().splitlines()
    kept = [row for row in rows if row.split(",")[1] in ("sensor", "A", "B")]
    (folder / "arrivals.csv").write_text("\n".join(kept) + "\n")
    target = tmp_path / "out"
    assert main(["bound", str(folder), "-o", str(target), "--map", "--cells", "3"]) == 3
    out = capsys.readouterr().out
    assert "NOT OBSERVABLE" in out.splitlines()[0]
    assert "the geometry does not determine the path: the position along " in out
    assert "not observable in 9 of 9 cells: " in out
    facts = json.loads((target / "bound.json").read_text())
    assert facts["observable"] is False
    assert facts["weakly_observed"]
    assert {path.name for path in target.glob("*.png")} == {"bound.png", "bound_map.png"}


def test_information_that_cannot_be_inverted_is_open_everywhere(
    recording, tmp_path, monkeypatch, capsys
):
    class Singular:
        cost = 1.0

        def factorise(self):
            raise NotPositiveDefiniteError

    monkeypatch.setattr("geograph.problem.Problem.linearise", lambda *_: Singular())
    target = tmp_path / "out"
    assert main(["bound", str(recording), "-o", str(target), "--map", "--cells", "3"]) == 3
    out, err = capsys.readouterr()
    assert err == ""
    assert "the information of the measurements is singular" in out
    lines = out.splitlines()
    assert next(line for line in lines if line.startswith("horizontal (m)")).split()[2:] == [
        "open", "open", "open",
    ]  # fmt: skip
    assert "not observable in 9 of 9 cells: the measurements say nothing" in out
    facts = json.loads((target / "bound.json").read_text())
    assert facts["sensors"]["A"]["azimuth_bias"]["sigma"] is None
    assert set(table(target / "bound.csv")["sigma_height_m"]) == {"nan"}
    assert len(list(target.glob("*.png"))) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bound"], "Missing argument"),
        (["bound", "none"], "none: no such file or folder"),
        (["bound", "{rec}", "--motion", "warp"], "unknown motion 'warp'; expected"),
        (["bound", "{rec}", "--process-noise", "big"], "--process-noise is 'big'"),
        (["bound", "{rec}", "--snr-db", "3"], "--band-hz, --integration-s missing; expected"),
        (["bound", "{rec}", "--envelope"], "--snr-db, --band-hz, --integration-s missing"),
        (
            ["bound", "{rec}", "--snr-db", "3", "--band-hz", "0", "1e6", "--integration-s", "1"],
            "has bearings only; a signal-to-noise ratio gives the sigmas of arrivals",
        ),
        (
            ["bound", "{rec}", "--snr-db", "3", "--band-hz", "9", "5", "--integration-s", "1"],
            "band_hz is 9.0 to 5.0; expected two frequencies",
        ),
        (["bound", "{rec}", "--extent-m", "5"], "--extent-m is the side of a map; give --map"),
        (["bound", "{rec}", "--map", "--cells", "1"], "cells is 1; expected 2 to 1000"),
        (["bound", "{rec}", "--map", "--extent-m", "-5"], "extent_m is -5.0; expected a finite"),
        (["bound", "{rec}", "-o", "{rec}"], "is a recording and is not overwritten"),
        (["bound", "{rec}", "-o", "{rec}/bearings.csv"], "is a file; expected a folder"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_input_is_one_line_with_status_2_and_nothing_is_written(
    recording, tmp_path, monkeypatch, capsys, *, arguments, message
):
    monkeypatch.chdir(tmp_path)
    words = [word.replace("{rec}", str(recording)) for word in arguments]
    if "-o" not in words and len(words) > 1:
        words += ["-o", "out"]
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("geograph: error: ")
    assert err.count("\n") == 1
    assert message in err
    assert not (tmp_path / "out").exists()


def test_results_of_a_smoother_are_not_overwritten(recording, tmp_path, capsys):
    target = tmp_path / "out"
    assert main(["smooth", str(recording), "-o", str(target), "--no-plots"]) == 0
    assert main(["bound", str(recording), "-o", str(target)]) == 2
    assert "expected a new or empty folder, or one that holds bound.json" in capsys.readouterr().err
    assert main(["bound", str(recording), "-o", str(tmp_path / "b"), "--no-plots"]) == 0
    assert main(["smooth", str(recording), "-o", str(tmp_path / "b")]) == 2
    capsys.readouterr()


def test_the_help_names_every_flag():
    done = subprocess.run(
        [sys.executable, "-m", "geograph", "bound", "--help"],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"COLUMNS": "200"},
    )
    flags = "output motion process-noise process-noise-along spacing elimination snr-db band-hz "
    flags += "integration-s coherent envelope map extent-m cells no-plots"
    for flag in flags.split():
        assert f"--{flag}" in done.stdout
    assert "3 not observable" in " ".join(done.stdout.split())


def test_on_a_terminal_the_tables_have_rules(recording):
    parent, child = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "geograph", "bound", str(recording)],
        stdout=child,
        stderr=subprocess.STDOUT,
        env=os.environ | {"COLUMNS": "200", "TERM": "xterm"},
    )
    os.close(child)
    text = b""
    while True:
        try:
            part = os.read(parent, 4096)
        except OSError:  # Linux: whoever wrote has gone.
            break
        if not part:
            break
        text += part
    os.close(parent)
    assert process.wait() == 0
    shown = text.decode()
    assert "───" in shown
    assert "small: Cramer-Rao bound at the true path" in shown
