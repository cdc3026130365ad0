"""Every published table and figure beside ours, by one command: what docs/accuracy.md is made from.

``python -m geograph.scenarios.accuracy -o DIR`` runs the studies one after another and writes the
tables of each to ``DIR/NAME.md``, figures of ours beside what was published, and
``DIR/accuracy.md``, which holds all of them. A study that is there with as many runs is kept, so
that the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from geograph.io.atomic import replacing_file
from geograph.scenarios import (
    angles_study,
    aoa_study,
    mixed_study,
    noise_study,
    orbit_study,
    resets_study,
    tdoa_graph,
    tdoa_study,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

FULL = 1000
"""Runs of the greatest study; those of the others are given for it, and scale with it."""

_MAIN = [f"emitter-{n}-{noise}" for n in (1, 2) for noise in ("1ns", "5ns", "10ns")]
_LEVY = ["--worlds", "levy-simple", "levy-staged"]


@dataclass(frozen=True, kw_only=True)
class Study:
    """One command and what it takes.

    Attributes
    ----------
    title
        Of its section.
    main
        Prints its tables.
    runs
        How many, of :data:`FULL` in the greatest; None: it has none.
    arguments
        Beside the number of runs.
    flag
        Of the number of runs.
    parallel
        Whether it takes ``--jobs``.
    """

    title: str
    main: Callable[[Sequence[str]], int]
    runs: int | None
    arguments: tuple[str, ...] = ()
    flag: str = "--runs"
    parallel: bool = False

    def command(self, scale: float, jobs: int) -> list[str]:
        """Return the arguments for a share of the runs."""
        given = list(self.arguments)
        if self.runs is not None:
            given += [self.flag, str(max(2, round(scale * self.runs)))]
        return [*given, "--jobs", str(jobs)] if self.parallel else given


STUDIES: dict[str, Study] = {
    "tdoa-estimators": Study(
        title="Time differences: the thesis's estimators",
        main=tdoa_study.main,
        runs=FULL,
        arguments=("--table", "published"),
    ),
    "tdoa-windows": Study(
        title="Time differences: by number of sets",
        main=tdoa_study.main,
        runs=FULL,
        arguments=("--table", "windows"),
    ),
    "tdoa-variants": Study(
        title="Time differences: all variants",
        main=tdoa_study.main,
        runs=FULL,
        arguments=("--table", "variants"),
    ),
    "tdoa-graph": Study(
        title="Time differences: the factor graph",
        main=tdoa_graph.main,
        runs=FULL,
        arguments=tuple(_MAIN),
        parallel=True,
    ),
    "mixed": Study(
        title="Bearings, time and frequency differences together",
        main=mixed_study.main,
        runs=240,
    ),
    "aoa-bounds": Study(
        title="Angles from the air: bounds",
        main=aoa_study.main,
        runs=None,
        arguments=("--table", "bounds"),
    ),
    "aoa-estimators": Study(
        title="Angles from the air: the thesis's estimators",
        main=aoa_study.main,
        runs=FULL,
        arguments=("--table", "published"),
    ),
    "aoa-graph": Study(
        title="Angles from the air: the factor graph",
        main=aoa_study.main,
        runs=160,
        arguments=("--table", "smoothed"),
        flag="--final",
    ),
    "aoa-beyond": Study(
        title="Angles from the air: beyond the thesis",
        main=aoa_study.main,
        runs=40,
        arguments=("--table", "beyond"),
        flag="--sequences",
    ),
    "angles-published": Study(
        title="Satellites, angles only: published estimators",
        main=angles_study.main,
        runs=200,
        arguments=("--table", "published"),
        parallel=True,
    ),
    "angles-graph": Study(
        title="Satellites, angles only: the factor graph",
        main=angles_study.main,
        runs=FULL,
        arguments=("--table", "graph", *_LEVY, "--seed", "100000"),
        parallel=True,
    ),
    "angles-choices": Study(
        title="Satellites, angles only: with the replaced values",
        main=angles_study.main,
        runs=200,
        arguments=("--table", "choices", "--seed", "200000"),
        parallel=True,
    ),
    "noise": Study(
        title="Process noise found",
        main=noise_study.main,
        runs=200,
    ),
    "resets-detection": Study(
        title="Calibrations at unknown times",
        main=resets_study.main,
        runs=9,
        arguments=("--table", "detection", "--worlds", "levy-simple", "--seed", "2000"),
    ),
    "resets-false-alarms": Study(
        title="Calibrations where there are none",
        main=resets_study.main,
        runs=200,
        arguments=("--table", "false-alarms", "--worlds", "levy-simple", "--seed", "1000"),
    ),
    "orbits": Study(
        title="Orbits from angles",
        main=orbit_study.main,
        runs=40,
        parallel=True,
    ),
}
"""Every study behind docs/accuracy.md, in its order."""


def tables_of(study: Study, arguments: Sequence[str]) -> str:
    """Return what a study prints; its rows on the error stream, as they come, are left out."""
    printed = io.StringIO()
    with redirect_stdout(printed), redirect_stderr(io.StringIO()):
        study.main(arguments)
    return printed.getvalue().strip()


def _write(path: Path, text: str) -> None:
    with replacing_file(path) as staging:
        staging.write_text(text, encoding="utf-8")


def _text(title: str, command: str, tables: str) -> str:
    return f"## {title}\n\n{command}\n\n{tables}\n"


def _command(study: Study, arguments: Sequence[str]) -> str:
    module = study.main.__module__
    return f"`python -m {' '.join([module, *arguments])}`"


def make(
    folder: Path, names: Sequence[str], *, runs: int = FULL, jobs: int = 1
) -> dict[str, list[Path]]:
    """Run studies into a folder, draw what they give, and write the page of all that is there.

    Parameters
    ----------
    folder
        Made if it is not there.
    names
        Of :data:`STUDIES`.
    runs
        Of the greatest study; the others have fewer in proportion, and two at least.
    jobs
        Processes.

    Returns
    -------
    dict
        The figures of each study that is there.
    """
    from geograph.plot._accuracy import draw

    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        study = STUDIES[name]
        arguments = study.command(runs / FULL, jobs)
        command, path = _command(study, study.command(runs / FULL, 1)), folder / f"{name}.md"
        if path.is_file() and command in path.read_text(encoding="utf-8").splitlines():
            print(f"{name}: kept", flush=True)
            continue
        print(f"{name}: {' '.join(arguments)}", flush=True)
        _write(path, _text(study.title, command, tables_of(study, arguments)))
    there = {
        name: (folder / f"{name}.md").read_text(encoding="utf-8")
        for name in STUDIES
        if (folder / f"{name}.md").is_file()
    }
    figures = draw(there, folder)
    parts = ["# Accuracy beside published figures\n"]
    for name, text in there.items():
        pictures = "".join(f"\n![{name}]({path.name})\n" for path in figures.get(name, ()))
        parts.append(text + pictures)
    _write(folder / "accuracy.md", "\n".join(parts))
    return figures


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the studies; see ``--help``."""
    parser = argparse.ArgumentParser(
        prog="python -m geograph.scenarios.accuracy",
        description="Every study of docs/accuracy.md: tables and figures, ours beside published.",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder")
    parser.add_argument(
        "--runs", type=int, default=FULL, help=f"of the greatest study ({FULL}); others scale"
    )
    parser.add_argument("--quick", action="store_true", help="a fiftieth of the runs")
    parser.add_argument("--jobs", type=int, default=1, help="processes (1)")
    parser.add_argument(
        "--only", nargs="+", choices=tuple(STUDIES), default=tuple(STUDIES), help="which studies"
    )
    options = parser.parse_args(arguments)
    if options.runs < 2 or options.jobs < 1:
        parser.error("expected --runs of at least 2 and --jobs of at least 1")
    runs = FULL // 50 if options.quick else options.runs
    figures = make(options.output, options.only, runs=runs, jobs=options.jobs)
    print(options.output / "accuracy.md")
    for path in sorted(path for paths in figures.values() for path in paths):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
