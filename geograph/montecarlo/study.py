"""All runs of a study, here, in processes or on a cluster."""

from __future__ import annotations

import itertools
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from geograph import __version__
from geograph.cluster import spread
from geograph.errors import InputError
from geograph.montecarlo.trial import CRASHED, Run, Task, run_trial
from geograph.results.write import plain
from geograph.workers import Lost

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from geograph.montecarlo.log import RunLog
    from geograph.recording import Recording

_FORMAT = 1


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is studied.

    Parameters
    ----------
    scenario
        What it is called.
    simulate
        Gives the recording, with its truth, of parameters and a seed; importable from a module.
    runs
        Number of runs, of each point of a sweep.
    seed
        Of the first run; that of run i is ``seed + i``, at every point of a sweep.
    parameters
        Those that differ from the scenario's defaults.
    sweep
        Values of one or two parameters; every combination is a point.
    changes
        Settings of the smoother that differ from the recordings' own.

    Raises
    ------
    InputError
        If there is no run, or the sweep is none.
    """

    scenario: str
    simulate: Callable[[Mapping[str, Any], int], Recording]
    runs: int
    seed: int = 0
    parameters: Mapping[str, Any] = field(default_factory=dict)
    sweep: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    changes: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.runs < 1 or self.seed < 0:
            raise InputError(
                f"{self.runs} runs from seed {self.seed}; expected at least 1 run and a seed of at "
                "least 0"
            )
        if len(self.sweep) > 2:
            raise InputError(f"a sweep of {len(self.sweep)} parameters; expected one or two")
        for name, values in self.sweep.items():
            if name in self.parameters:
                raise InputError(f"{name} is set and swept; expected one of the two")
            if not values or len({repr(value) for value in values}) < len(values):
                raise InputError(f"the sweep of {name} has a value twice, or none")

    @property
    def points(self) -> list[dict[str, Any]]:
        """The parameters that are swept, for each point; one empty for a study without a sweep."""
        return [
            dict(zip(self.sweep, chosen, strict=True))
            for chosen in itertools.product(*self.sweep.values())
        ]

    def tasks(self) -> list[Task]:
        """Return all runs, those of a point together."""
        found = []
        for point, chosen in enumerate(self.points):
            values = tuple({**self.parameters, **chosen}.items())
            found += [Task(point, run, values, self.seed + run) for run in range(self.runs)]
        return found

    def identity(self) -> dict[str, Any]:
        """Return what two studies must agree in for one to go on with the other's runs."""
        return {
            "geograph_montecarlo": _FORMAT,
            "geograph": __version__,
            "scenario": self.scenario,
            "seed": self.seed,
            "parameters": plain(dict(self.parameters)),
            "sweep": plain(dict(self.sweep)),
            "settings": plain(dict(self.changes)),
        }


def run_study(
    plan: Plan,
    *,
    log: RunLog | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    on_done: Callable[[Run], None] | None = None,
) -> list[list[Run]]:
    """Do the runs of a study that are not done yet.

    Parameters
    ----------
    plan
        What is studied.
    log
        Where finished runs are kept and found.
    workers, scheduler
        As in :func:`geograph.cluster.spread`.
    on_done
        Called with each run: those found first, then those done, as they come.

    Returns
    -------
    list of list of Run
        For each point its runs, in their order, whatever order they were done in.

    Raises
    ------
    InputError
        If the scheduler is of no use, or the log damaged.
    """
    done: dict[tuple[int, int], Run] = {}

    def keep(run: Run) -> None:
        done[run.point, run.run] = run
        if on_done is not None:
            on_done(run)

    for run in log.runs() if log is not None else ():
        # A study may go on with fewer runs than were done.
        if run.run < plan.runs:
            keep(run)
    tasks = [task for task in plan.tasks() if (task.point, task.run) not in done]
    trial = partial(run_trial, simulate=plan.simulate, changes=dict(plan.changes))
    if tasks:
        with closing(spread(trial, tasks, workers=workers, scheduler=scheduler)) as results:
            for index, result in results:
                if isinstance(result, Lost):
                    # Not logged, so that the next command tries it again.
                    keep(Run.without_scores(tasks[index], CRASHED, result.reason))
                    continue
                if log is not None:
                    log.append(result)
                keep(result)
    return [[done[point, run] for run in range(plan.runs)] for point in range(len(plan.points))]
