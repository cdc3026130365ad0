"""Contestants: everything that can smooth a pass.

Another one is a module here with a subclass of :class:`Contestant`, entered in :data:`CONTESTANTS`.
"""

from __future__ import annotations

from contestants.base import Contestant, Estimate, Run, Stages
from contestants.ceres import Ceres
from contestants.engine import Engine
from contestants.filter_py import FilterPy
from contestants.gri import Gri
from contestants.per_bearing import PerBearing
from contestants.reference import Reference
from contestants.sparse import LeastSquares, SparseGaussNewton
from contestants.stone_soup import StoneSoup
from contestants.stone_soup_each import StoneSoupEach
from contestants.symforced import Symforce

CONTESTANTS: dict[str, type[Contestant]] = {
    contestant.name: contestant
    for contestant in (
        Engine,
        Reference,
        PerBearing,
        SparseGaussNewton,
        LeastSquares,
        Ceres,
        Symforce,
        StoneSoupEach,
        StoneSoup,
        FilterPy,
        Gri,
    )
}
"""By name, ours first."""

__all__ = ["CONTESTANTS", "Contestant", "Estimate", "Run", "Stages"]
