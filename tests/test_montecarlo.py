"""``geograph montecarlo``: seeded runs, the same everywhere, kept through crashes."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from geograph.cli import main
from geograph.consistency import divergence, limit, mean_band, nees
from geograph.errors import InputError
from geograph.montecarlo import Plan, Run, Task, run_study, run_trial, study_figures
from geograph.montecarlo.figures import point_figures, wilson
from geograph.montecarlo.log import LOG, RunLog
from geograph.scenarios.registry import simulate

ROOM = ("room", "--set", "bearings=30", "--no-plots")
SMALL = {"bearings": 30}


def plan(**options):
    made = {"scenario": "room", "simulate": partial(simulate, "room"), "runs": 4}
    return Plan(**(made | {"parameters": SMALL} | options))


def figures_of(file):
    found = json.loads(file.read_text())
    found.pop("times")
    return json.dumps(found)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A study of this process: its folder."""
    folder = tmp_path_factory.mktemp("study") / "one"
    assert main(["montecarlo", *ROOM, "--runs", "6", "--jobs", "1", "-o", str(folder)]) == 0
    return folder


def test_processes_give_the_same_as_one_byte_for_byte(done, tmp_path):
    arguments = [*ROOM, "--runs", "6", "--jobs", "2", "--json", str(tmp_path / "two.json")]
    assert main(["montecarlo", *arguments]) == 0
    assert figures_of(tmp_path / "two.json") == figures_of(done / "montecarlo.json")


def test_a_run_depends_on_its_seed_alone(done):
    study = plan(runs=1, seed=4)
    ((alone,),) = run_study(study)
    lines = (done / LOG).read_text().splitlines()[1:]
    (logged,) = (run for run in map(json.loads, lines) if run["run"] == 4)
    assert (alone.seed, logged["seed"]) == (4, 4)
    np.testing.assert_array_equal(
        alone.nees, [np.nan if value is None else value for value in logged["nees"]]
    )


def test_a_study_goes_on_after_it_was_killed(done, tmp_path):
    folder = tmp_path / "study"
    command = [sys.executable, "-m", "geograph", "montecarlo", *ROOM, "--runs", "6"]
    process = subprocess.Popen([*command, "-o", str(folder), "--jobs", "1"])
    log = folder / LOG
    deadline = time.monotonic() + 60.0
    while not (log.exists() and log.read_bytes().count(b"\n") > 2) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.kill()
    process.wait()
    kept = log.read_bytes().splitlines(keepends=True)
    assert 3 <= len(kept) < 8
    # A crash in the middle of a line.
    log.write_bytes(b"".join(kept) + b'{"point":0,"run":5,"se')
    assert main(["montecarlo", *ROOM, "--runs", "6", "-o", str(folder), "--jobs", "1"]) == 0
    after = log.read_bytes().splitlines(keepends=True)
    assert after[: len(kept)] == kept
    assert len(after) == 7
    assert figures_of(folder / "montecarlo.json") == figures_of(done / "montecarlo.json")


def test_more_runs_are_added_to_those_that_are_there(done, tmp_path):
    folder = tmp_path / "study"
    for runs in ("3", "6"):
        assert main(["montecarlo", *ROOM, "--runs", runs, "-o", str(folder), "--jobs", "1"]) == 0
    assert figures_of(folder / "montecarlo.json") == figures_of(done / "montecarlo.json")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["--seed", "1"], "holds runs with seed 0; asked for 1; repeat the command"),
        (["--set", "sensors=3"], 'holds runs with parameters {"bearings": 30}; asked for'),
        (["--process-noise", "2"], "holds runs with settings {}; asked for"),
        (["--sweep", "sensors=2,3"], "holds runs with sweep {}; asked for"),
    ],
)
def test_other_settings_in_the_same_folder_are_refused(done, changes, message, capsys):
    before = (done / LOG).read_bytes()
    assert main(["montecarlo", *ROOM, "--runs", "6", "-o", str(done), *changes]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert (done / LOG).read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["levvy-simple"], "unknown scenario 'levvy-simple'; did you mean levy-simple"),
        (["room", "--runs", "0"], "Invalid value for '--runs'"),
        (["room", "--set", "arrays=3"], "scenario room: unknown parameter 'arrays'"),
        (["room", "--set", "sigma_rad=-1"], "a sigma_azimuth_rad of -1; expected above 0"),
        (["room", "--sweep", "sensors=2,many"], "sensors=many; expected a whole number"),
        (["room", "--sweep", "sensors=2,2"], "the sweep of sensors has a value twice"),
        (["room", "--sweep", "sensors"], "--sweep 'sensors'; expected NAME=VALUE"),
        (["room", "--sweep", "sensors=2,9"], "9 sensors; expected 2 to 5"),
        (["room", "--set", "sensors=3", "--sweep", "sensors=2,4"], "sensors is set and swept"),
        (
            ["room", *(w for n in ("sensors=2", "order=2", "bearings=9") for w in ("--sweep", n))],
            "a sweep of 3 parameters; expected one or two",
        ),
        (["room", "--loss", "hubber"], "hubber"),
        (["room", "--json", "absent/file.json"], "is in a folder that does not exist"),
        (["room", "--scheduler", "tcp://127.0.0.1:9"], "no Dask scheduler answers there"),
        (["room", "--scheduler", "nonsense://x"], "no Dask scheduler answers there"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    arguments, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("geograph.cluster.CONNECT_S", 0.5)
    assert main(["montecarlo", *arguments, "-o", "new"]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_folders_of_other_things_and_damaged_logs_are_refused(tmp_path):
    identity = plan().identity()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds other files \('notes.txt'\) but no runs.jsonl"):
        RunLog(tmp_path / "other", identity)
    with RunLog(tmp_path / "log", identity), pytest.raises(InputError, match="is in use by"):
        RunLog(tmp_path / "log", identity)
    with (tmp_path / "log" / LOG).open("a") as file:
        file.write("{}\n")
    with (
        RunLog(tmp_path / "log", identity) as log,
        pytest.raises(InputError, match=r"runs\.jsonl:2: is damaged; remove the line"),
    ):
        list(log.runs())


def test_runs_that_fail_are_listed_with_their_seeds(tmp_path, capsys):
    name = "degenerate-two-receivers"
    target = tmp_path / "found.json"
    assert main(["montecarlo", name, "--runs", "2", "--jobs", "1", "--json", str(target)]) == 3
    shown = capsys.readouterr().out
    assert "2 runs did not converge:" in shown
    assert f"(geograph simulate {name} --seed 1)" in shown
    (point,) = json.loads(target.read_text())["points"]
    assert [failure["seed"] for failure in point["failures"]] == [0, 1]
    assert point["converged_share"] == 0.0


def refuse(values, seed):
    if seed == 1:
        raise KeyError("nobody expected this")
    return simulate("room", values, seed)


def test_an_unexpected_error_costs_its_run_alone_and_is_not_kept(tmp_path):
    study = plan(simulate=refuse, runs=3)
    with RunLog(tmp_path / "log", study.identity()) as log:
        ((first, lost, last),) = run_study(study, log=log)
        assert [first.status, last.status] == ["converged", "converged"]
        assert lost.status == "crashed"
        assert "KeyError" in lost.message
        assert [run.run for run in log.runs()] == [0, 2]


def test_a_sweep_has_a_point_for_every_pair(tmp_path):
    arguments = ["room", "--set", "bearings=20", "--runs", "2", "-o", str(tmp_path / "s")]
    sweep = ["--sweep", "sensors=3,4", "--sweep", "sigma_rad=0.002,0.02"]
    assert main(["montecarlo", *arguments, *sweep, "--jobs", "1"]) == 0
    found = json.loads((tmp_path / "s" / "montecarlo.json").read_text())
    chosen = [(p["set"]["sensors"], p["set"]["sigma_rad"]) for p in found["points"]]
    assert chosen == [(3, 0.002), (3, 0.02), (4, 0.002), (4, 0.02)]
    # The seeds are the same at every point: less noise, a lower bound.
    assert found["points"][0]["bound_m"] < found["points"][1]["bound_m"]
    pictures = {path.name for path in (tmp_path / "s").glob("*.png")}
    assert pictures == {"sweep.png", *(f"montecarlo-{i}.png" for i in range(1, 5))}


@pytest.mark.parametrize("name", ["room", "formation", "indoor"])
def test_the_bound_of_a_run_is_that_of_its_geometry(name):
    """The same as ``geograph bound`` at the truth: there with errors of sensors at zero."""
    from geograph import bound

    values = {"flat": True} if name == "indoor" else {}
    run = run_trial(
        Task(0, 0, tuple(values.items()), 2), simulate=partial(simulate, name), changes={}
    )
    assert run.converged
    recording = simulate(name, values, 2)
    found = bound(recording)
    axes = run.axes
    assert axes == (2 if name == "indoor" else 3)
    trace = np.trace(found.position_covariance_m2[:, :axes, :axes], axis1=1, axis2=2)
    expected = np.interp(run.time_s, found.time_s, trace)
    # Between knots the covariance is not straight: compared as a mean over the path.
    inside = ~np.isnan(run.bound_m2)
    assert np.sqrt(run.bound_m2[inside].mean() / expected[inside].mean()) == pytest.approx(
        1.0, abs=0.03
    )


def made(rng, runs, *, scale=1.0, axes=3, points=5):
    """Return runs with errors from a known covariance; their NEES are ``scale`` times its."""
    found = []
    for index in range(runs):
        task = Task(0, index, (), index)
        error = rng.normal(size=(points, axes))
        square = np.sum(error**2, axis=1)
        found.append(
            replace(
                Run.without_scores(task, "converged"),
                axes=axes,
                time_s=np.arange(float(points)),
                square_m2=square,
                sigma2_m2=np.full(points, axes / scale),
                bound_m2=np.full(points, float(axes)),
                nees=square * scale,
            )
        )
    return found


def test_honest_draws_score_as_honest_and_others_do_not():
    """Bounds of four standard errors: a false alarm of 6e-5 each; the seed is fixed."""
    honest = point_figures(made(np.random.default_rng(3), 400))
    assert abs(honest["anees"] - 3.0) < 4.0 * honest["anees_error"]
    assert abs(honest["rmse_over_bound"] - 1.0) < 4.0 * honest["rmse_over_bound_error"]
    for entry in honest["coverage"]:
        assert abs(entry["share"] - entry["probability"]) < 4.0 * entry["error"]
    assert honest["divergence"] < 0.02
    proud = point_figures(made(np.random.default_rng(3), 400, scale=2.0))
    assert proud["anees"] > 3.0 + 20.0 * proud["anees_error"]
    assert proud["divergence"] > 0.1
    assert proud["coverage"][2]["share"] < 0.9
    assert proud["over_time"]["anees_share_in_band"] == 0.0


def test_by_run_a_wide_geometry_weighs_no_more_than_others():
    """A wide run twice as good as its bound says hides 400 honest ones from RMSE/bound."""
    runs = made(np.random.default_rng(5), 400)
    runs += [replace(run, square_m2=0.25e6 * run.square_m2, bound_m2=1e6 * run.bound_m2)
             for run in made(np.random.default_rng(6), 1)]  # fmt: skip
    found = point_figures(runs)
    assert found["rmse_over_bound"] < 0.7
    error = found["rmse_over_bound_by_run_error"]
    assert error < 0.02
    assert abs(found["rmse_over_bound_by_run"] - 1.0) < 4.0 * error


def test_what_a_run_does_not_reach_does_not_count():
    runs = made(np.random.default_rng(0), 10, axes=2)
    short = replace(runs[0], nees=runs[0].nees.copy(), square_m2=runs[0].square_m2.copy())
    short.nees[-1] = short.square_m2[-1] = np.nan
    found = point_figures([short, *runs[1:]])
    assert found["over_time"]["runs"].tolist() == [10, 10, 10, 10, 9]
    assert sum(found["histogram"]["count"]) == 49
    assert found["anees_expected"] == 2


def test_statistics_against_their_tables():
    # Chi-square with 3 and with 30 degrees of freedom; Wilson's interval of 8 of 10.
    assert limit(0.95) == pytest.approx(7.8147, abs=1e-4)
    assert mean_band(10, 3, alarm=0.05) == pytest.approx((1.6791, 4.6979), abs=1e-4)
    assert wilson(8, 10) == pytest.approx([0.4902, 0.9433], abs=1e-4)
    assert nees(np.ones((1, 2)), np.diag([1.0, 4.0])[None]).tolist() == [1.25]
    # All of one bin of probability 0.05.
    assert divergence(np.full(7, float(limit(0.52)))) == pytest.approx(np.log(20.0))


def test_figures_do_not_depend_on_the_order_of_the_runs():
    study = plan(runs=4)
    ((*runs,),) = run_study(study)
    once = study_figures(study, [runs])
    again = study_figures(study, [list(runs)])
    assert json.dumps(once) == json.dumps(again)
