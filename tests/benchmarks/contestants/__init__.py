"""Contestants: everything that can smooth a pass.

Another one is a module here with a subclass of :class:`Contestant`, entered in :data:`CONTESTANTS`.
"""

from __future__ import annotations

from contestants.base import Contestant, Estimate, Run, Stages
from contestants.engine import Engine
from contestants.per_bearing import PerBearing
from contestants.reference import Reference

CONTESTANTS: dict[str, type[Contestant]] = {
    contestant.name: contestant for contestant in (Engine, Reference, PerBearing)
}
"""By name, ours first."""

__all__ = ["CONTESTANTS", "Contestant", "Estimate", "Run", "Stages"]
