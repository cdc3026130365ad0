"""Simulated worlds with known truth, written from geometry.

Nothing here uses an equation of the estimator: light times are solved in axes that do not turn,
orbits are integrated there, directions come from PROJ, and random paths from Van Loan's method, so
that a mistake in ``geograph.factors`` shows as a disagreement.

Each world comes as a function that returns a recording (``low_orbit_pass``, ``ground_pass``,
``room``) and as one that returns all that the recording hides as well (``low_orbit_world``, ...),
with the options of its dataclass (``LowOrbit``, ...).
"""

from geograph.scenarios.ground import GroundPass, ground_pass, ground_world
from geograph.scenarios.low_orbit import LowOrbit, low_orbit_pass, low_orbit_world
from geograph.scenarios.observation import Observed, light_time, observe_bearings
from geograph.scenarios.sensor_errors import TrueErrors
from geograph.scenarios.sound import Room, room, room_world
from geograph.scenarios.worlds import Noise, Station, Streams, World, make_world

__all__ = [
    "GroundPass",
    "LowOrbit",
    "Noise",
    "Observed",
    "Room",
    "Station",
    "Streams",
    "TrueErrors",
    "World",
    "ground_pass",
    "ground_world",
    "light_time",
    "low_orbit_pass",
    "low_orbit_world",
    "make_world",
    "observe_bearings",
    "room",
    "room_world",
]
