"""The command that makes every table and figure of docs/accuracy.md, at its smallest."""

import re
from pathlib import Path

import numpy as np
import pytest

from geograph.plot import _accuracy as plot
from geograph.scenarios import accuracy, orbit_study
from geograph.scenarios.angles_study import PUBLISHED

DOCS = Path(__file__).parents[1] / "docs" / "accuracy.md"


def test_studies_are_run_kept_and_drawn(tmp_path, capsys):
    names = ["tdoa-estimators", "aoa-bounds"]
    command = ["-o", str(tmp_path), "--runs", "2", "--only", *names]
    assert accuracy.main(command) == 0
    first = (tmp_path / "tdoa-estimators.md").read_text()
    assert "tdoa_study --table published --runs 2`" in first
    found = plot.tables(first)[0]
    assert plot.number(found["emitter-1-1ns"]["published"]) == 169.0
    assert plot.number(found["emitter-1-1ns"]["bound"]) == pytest.approx(31.9)
    page = (tmp_path / "accuracy.md").read_text()
    assert "![tdoa-estimators](tdoa-estimators.png)" in page
    assert (tmp_path / "tdoa-estimators.png").read_bytes()[:4] == b"\x89PNG"
    capsys.readouterr()
    # What is there is kept; other numbers of runs are run anew.
    assert accuracy.main([*command[:4], "--only", *names]) == 0
    assert capsys.readouterr().out.count(": kept\n") == 2
    accuracy.main(["-o", str(tmp_path), "--runs", "3", "--only", "tdoa-estimators"])
    assert ": kept" not in capsys.readouterr().out
    assert (tmp_path / "tdoa-estimators.md").read_text() != first


def test_every_command_of_the_page_is_a_study():
    """Modules that the docs name are those that are run."""
    named = set(
        re.findall(r"python -m (geograph\.scenarios\.\w+_(?:study|graph))", DOCS.read_text())
    )
    assert named == {study.main.__module__ for study in accuracy.STUDIES.values()}


def test_tables_of_all_kinds_are_drawn(tmp_path):
    """From the published page, whose columns are those of the commands or near."""
    worlds = [
        "| estimator | converged % | by %, mean | ANEES | KL |\n| --- | --- | --- | --- | --- |\n"
        f"| {name} | 99.0±0.1 | 20.1±0.2 (20.8) | 3.1±0.1 (8.59) | 0.1±0.01 |"
        for name in ("BDNLO", "factor graph")
        for _ in PUBLISHED
    ]
    cases = (
        "| case | RMSE / bound | ratio | ANEES | 99 % band |\n| --- | --- | --- | --- | --- |\n"
        "| orbit | 1.02±0.05 | 0.98±0.02 | 3.1 | 2.1 to 4.0 |"
    )
    texts = {
        "angles-published": "\n\n".join(worlds[:4]),
        "angles-graph": worlds[-1],
        "mixed": cases,
        "orbits": cases,
        "aoa-estimators": "| scenario | least squares | printed | ratio | EKF | printed |\n"
        "| --- | --- | --- | --- | --- | --- |\n| 1-5deg | 800±20 | 950 | 0.8 | 600±7 | 756 |",
    }
    made = plot.draw(texts, tmp_path)
    assert set(made) == {"angles-published", "mixed", "orbits", "aoa-estimators"}
    for paths in made.values():
        assert all(path.stat().st_size > 5000 for path in paths)
    row = plot.tables(texts["aoa-estimators"])[0]["1-5deg"]
    assert (plot.number(row["printed"]), plot.number(row["printed 2"])) == (950.0, 756.0)
    cell = plot.tables(worlds[0])[0]["BDNLO"]["by %, mean"]
    assert (plot.number(cell), plot.spread(cell), plot.printed(cell)) == (20.1, 0.2, 20.8)
    assert np.isnan(plot.number("-"))


def test_an_orbit_study_is_printed(capsys):
    assert orbit_study.main(["orbit-transfer-perigee", "--runs", "2", "--seed", "3"]) == 0
    (row,) = plot.tables(capsys.readouterr().out)[0].values()
    assert row["converged"] == "2 of 2"
    assert plot.number(row["bound m"]) > 0.0
    # Two runs: chi-square with 3 degrees of freedom each; a mean above 11 once in ten thousand.
    assert plot.number(row["ANEES"]) < 11.0
    with pytest.raises(SystemExit):
        orbit_study.main(["nowhere"])
