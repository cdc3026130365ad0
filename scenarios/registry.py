"""Every scenario by name, with its parameters, what it is, and where it comes from.

What ``geograph simulate`` writes and ``geograph montecarlo`` repeats. A scenario and a seed give
the same recording, bit for bit, with its truth table.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.errors import InputError
from geograph.scenarios import parameters as parameters_of
from geograph.scenarios.airborne import SCENARIOS as KALLIN
from geograph.scenarios.airborne import Airborne, beyond
from geograph.scenarios.airborne_recordings import recordings as airborne_recordings
from geograph.scenarios.angles_worlds import CALIBRATED, WORLDS, angles_trial
from geograph.scenarios.ground import GroundPass, ground_world
from geograph.scenarios.low_orbit import LowOrbit, low_orbit_world
from geograph.scenarios.moving_sensors import VARIANTS, MovingSensors
from geograph.scenarios.moving_sensors import recordings as moving_recordings
from geograph.scenarios.radio_aircraft import Multilateration, multilateration_world
from geograph.scenarios.radio_degenerate import DEGENERATE, degenerate_world
from geograph.scenarios.radio_indoor import Indoor, indoor_world
from geograph.scenarios.radio_mixed import Mixed, mixed_world
from geograph.scenarios.radio_orbit import Formation, formation_world
from geograph.scenarios.radio_platforms import Platforms, platforms_world
from geograph.scenarios.satellites import CASES, satellite_world
from geograph.scenarios.sound import Microphones, Room, microphones_world, room_world

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from geograph.recording import Recording
    from geograph.scenarios.parameters import Value
    from geograph.scenarios.radio_degenerate import Degenerate

_OURS = "geograph"
_SPRANG = "R. Sprang, AFIT 2015"
_LEVY = "Levy et al., ISPRS"
_KALLIN = "T. Kallin, Linkoping University 2021"
_CAMLICA = "S. Camlica, METU 2009"


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A world that can be simulated with any seed.

    Parameters
    ----------
    name
        By which it is known.
    title
        What it is, in one line.
    source
        Where it comes from: a publication, or geograph itself.
    kind
        Gives the dataclass of its parameters with their defaults.
    recording
        Gives the recording, with its truth, of a seed and a kind.
    hidden
        Fields of the kind that are no parameters.
    beside
        Gives the text of further files that lie beside the recording's, by their names: what its
        sensors hide. None: there are none.
    """

    name: str
    title: str
    source: str
    kind: Callable[[], Any]
    recording: Callable[[int, Any], Recording]
    hidden: frozenset[str] = field(default=frozenset({"name", "source"}))
    beside: Callable[[int, Any], dict[str, str]] | None = None

    def parameters(self) -> dict[str, Value]:
        """Return its parameters and their defaults."""
        return parameters_of.flat(self.kind(), hidden=self.hidden)

    def parse(self, name: str, text: str) -> Value:
        """Return a parameter's value from text.

        Raises
        ------
        InputError
            If there is no such parameter, or the text does not fit it.
        """
        try:
            return parameters_of.parse(self.kind(), name, text, hidden=self.hidden)
        except InputError as error:
            raise InputError(f"scenario {self.name}: {error.reason}") from None

    def simulate(self, seed: int, values: Mapping[str, Value] | None = None) -> Recording:
        """Return the recording of a seed, with its truth.

        Parameters
        ----------
        seed
            A whole number of at least 0.
        values
            Parameters that differ from the defaults.

        Raises
        ------
        InputError
            If there is no such world.
        """
        given = dict(values or {})
        try:
            made = self.recording(seed, parameters_of.changed(self.kind(), given))
            _check_sigmas(made)
        except (ValueError, RuntimeError, ZeroDivisionError, IndexError, OverflowError) as error:
            shown = ", ".join(f"{key}={parameters_of.show(value)}" for key, value in given.items())
            what = f"scenario {self.name}{f' with {shown}' if shown else ''}, seed {seed}"
            raise InputError(f"{what}: cannot be simulated ({error}); change its parameters") from (
                error
            )
        return made

    def files_beside(self, seed: int, values: Mapping[str, Value] | None = None) -> dict[str, str]:
        """Return the text of the files beside the recording of :meth:`simulate`, by their names."""
        if self.beside is None:
            return {}
        return self.beside(seed, parameters_of.changed(self.kind(), dict(values or {})))


@dataclass(frozen=True, kw_only=True)
class _Degenerate:
    """Parameters of :func:`geograph.scenarios.radio_degenerate.degenerate_world`."""

    case: Degenerate
    sigma_s: float = 10e-9


@cache
def scenarios() -> dict[str, Scenario]:
    """Return every scenario, by its name."""
    every = (*_satellites(), *_orbits(), *_ground(), *_sound(), *_radio(), *_airborne(), *_moving())
    return {scenario.name: scenario for scenario in every}


def scenario(name: str) -> Scenario:
    """Return a scenario.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    known = scenarios()
    if name not in known:
        raise InputError(
            f"unknown scenario {name!r}; {parameters_of.near(name, known)} "
            "(geograph simulate --list shows all)"
        )
    return known[name]


def simulate(name: str, values: Mapping[str, Value], seed: int) -> Recording:
    """Return the recording of a scenario and a seed; see :meth:`Scenario.simulate`."""
    return scenario(name).simulate(seed, values)


def _satellites() -> Iterator[Scenario]:
    titles = {
        "sprang-simple": "Satellites watch one in free fall; inertial units drift between resets",
        "sprang-staged": "The same, the object driven by random forces in stages",
        "levy-simple": "Satellites watch one in free fall; biases, drifts and instabilities",
        "levy-staged": "The same, the object driven by random forces in stages",
        "levy-simple-calibrated": "The same as levy-simple, with calibrations at unknown times",
        "levy-staged-calibrated": "The same as levy-staged, with calibrations at unknown times",
    }
    for name, world in (WORLDS | CALIBRATED).items():
        unused = {"stages"} if world.path == "simple" else set()
        yield Scenario(
            name=name,
            title=titles[name],
            source=_SPRANG if name.startswith("sprang") else _LEVY,
            kind=partial(_given, world),
            recording=lambda seed, kind: angles_trial(seed, kind).recording,
            beside=lambda seed, kind: angles_trial(seed, kind).sensor_truth.files(),
            hidden=frozenset({"name", "source", "path", "windows"} | unused),
        )
    yield Scenario(
        name="low-orbit",
        title="An object in low orbit, seen by satellites or from the ground",
        source=f"after {_LEVY}",
        kind=LowOrbit,
        recording=lambda seed, kind: low_orbit_world(seed, kind).recording,
    )


def _orbits() -> Iterator[Scenario]:
    for name, (title, kind) in CASES.items():
        yield Scenario(
            name=name,
            title=title,
            source=_OURS,
            kind=partial(_given, kind),
            recording=partial(_of_world, satellite_world),
        )


def _ground() -> Iterator[Scenario]:
    for name, title, target in (
        ("fireball", "A fireball over cameras with wrong clocks", "fireball"),
        ("aircraft-cameras", "An aircraft over cameras with wrong clocks", "aircraft"),
    ):
        yield Scenario(
            name=name,
            title=title,
            source=_OURS,
            kind=partial(GroundPass, target=target),  # type: ignore[arg-type]
            recording=lambda seed, kind: ground_world(seed, kind).recording,
            hidden=frozenset({"target"}),
        )


def _sound() -> Iterator[Scenario]:
    yield Scenario(
        name="room",
        title="A source of sound walks through a hall, heard by arrays that give directions",
        source=_OURS,
        kind=Room,
        recording=lambda seed, kind: room_world(seed, kind).recording,
    )
    yield Scenario(
        name="microphones",
        title="A drone or a vehicle among microphones: arrival times of claps",
        source=_OURS,
        kind=Microphones,
        recording=lambda seed, kind: microphones_world(seed, kind).recording,
    )


def _radio() -> Iterator[Scenario]:
    made: tuple[tuple[str, str, str, Callable[[], Any], Callable[[int, Any], Any]], ...] = (
        (
            "multilateration",
            "An aircraft, its messages timed by receivers on the ground",
            _OURS,
            Multilateration,
            multilateration_world,
        ),
        ("indoor", "A tag in a hall, its pulses timed by anchors", _OURS, Indoor, indoor_world),
        (
            "drone",
            "A drone: bearings of two cameras, time and frequency differences of four receivers",
            _OURS,
            partial(Mixed, target="drone"),
            mixed_world,
        ),
        (
            "ship",
            "A ship off the coast: the same kinds of measurement",
            _OURS,
            partial(Mixed, target="ship"),
            mixed_world,
        ),
        (
            "formation",
            "Satellites receive an emitter on the ground: time and frequency differences",
            _OURS,
            Formation,
            formation_world,
        ),
        (
            "platforms",
            "Four platforms fly and hear a far emitter in the plane",
            f"after {_CAMLICA}",
            Platforms,
            platforms_world,
        ),
    )
    for name, title, source, kind, world in made:
        yield Scenario(
            name=name,
            title=title,
            source=source,
            kind=kind,
            recording=partial(_of_world, world),
            hidden=frozenset({"target"} if name in ("drone", "ship") else ()),
        )
    for case in DEGENERATE:
        yield Scenario(
            name=f"degenerate-{case}",
            title="A geometry from which an emitter can not be located, or not in one place only",
            source=_OURS,
            kind=partial(_Degenerate, case=case),
            recording=lambda seed, kind: (
                degenerate_world(kind.case, seed, sigma_s=kind.sigma_s).recording
            ),
            hidden=frozenset({"case"}),
        )


def _airborne() -> Iterator[Scenario]:
    flown = "An emitter on the ground, directions of 5 or 10 degrees from aircraft"
    for name, kind in KALLIN.items():
        yield _from_the_air(f"kallin-{name}", flown, _KALLIN, partial(_given, kind))
    for name, title in (
        ("mountains", "The same over mountain ranges, from one aircraft"),
        ("road", "The same, the emitter drives along a winding road"),
        ("road-mountains", "The same, the emitter drives through mountains"),
        ("azimuth-only", "The same without elevations, from one aircraft"),
        ("rolling", "The same from an aircraft that rolls 30 degrees to either side"),
    ):
        # Their ground is made first when one of them is wanted.
        yield _from_the_air(f"kallin-{name}", title, f"after {_KALLIN}", partial(_harder, name))


def _from_the_air(name: str, title: str, source: str, kind: Callable[[], Airborne]) -> Scenario:
    return Scenario(
        name=name,
        title=title,
        source=source,
        kind=kind,
        recording=lambda seed, chosen: next(airborne_recordings(chosen, [seed])),
        hidden=frozenset({"name", "land", "target_m"}),
    )


def _moving() -> Iterator[Scenario]:
    for name, variant in VARIANTS.items():
        yield Scenario(
            name=f"camlica-{name}",
            title="Aircraft in the plane hear an emitter 100 km away: arrival times",
            source=_CAMLICA,
            kind=partial(_given, variant),
            recording=_of_moving,
        )


def _check_sigmas(recording: Recording) -> None:
    for table in recording.tables.values():
        for column in fields(table):
            if column.name.startswith("sigma"):
                least = float(np.nanmin(getattr(table, column.name), initial=np.inf))
                if not least > 0.0:
                    raise ValueError(f"a {column.name} of {least:g}; expected above 0")


def _given(kind: Any) -> Any:
    return kind


def _harder(name: str) -> Airborne:
    return beyond()[name]


def _of_world(world: Callable[[int, Any], Any], seed: int, kind: Any) -> Recording:
    recording: Recording = world(seed, kind).recording
    return recording


def _of_moving(seed: int, kind: MovingSensors) -> Recording:
    if not kind.straight_platforms:
        return next(moving_recordings(kind, [seed]))
    # With the fix after the last set, which the study leaves out: a recording's fixes must cover
    # its arrivals to be read.
    made = next(moving_recordings(replace(kind, straight_platforms=False), [seed]))
    straight = {
        name: replace(sensor, platform_process_noise=0.0) for name, sensor in made.sensors.items()
    }
    return replace(made, sensors=straight)
