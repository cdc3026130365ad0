"""Monte Carlo: a scenario smoothed many times, and how honest and how good the results are.

Each run is a recording with its truth, made from a seed, smoothed and scored. A run depends on the
study's seed and its own number alone (its seed is their sum), so that any of them can be made
again, in whatever order and on whatever machine they were done:

- :mod:`geograph.montecarlo.trial`: one run and its scores;
- :mod:`geograph.montecarlo.log`: the finished runs in a folder, from which a study goes on;
- :mod:`geograph.montecarlo.study`: all runs, here, in processes or on a cluster;
- :mod:`geograph.montecarlo.figures`: what they show, as JSON.
"""

from geograph.montecarlo.figures import study_figures
from geograph.montecarlo.study import Plan, run_study
from geograph.montecarlo.trial import Run, Task, run_trial

__all__ = ["Plan", "Run", "Task", "run_study", "run_trial", "study_figures"]
