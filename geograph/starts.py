"""From a recording made ready to the problem that the smoother starts with."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.families import BearingFamily, Values
from geograph.initialise import FirstGuess
from geograph.knots import Resolution, automatic_spacing, check_memory, place_knots
from geograph.motion import Density, Motion
from geograph.orbit_forces import forces_of
from geograph.problem import PathPrior, Problem
from geograph.process_noise import guess_noise
from geograph.stages import Stages
from geograph.states import CLOCK, ELEVATION, MISALIGNMENT, POSITION
from geograph.terrain_starts import ground_height, levelled, terrain_fits

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.factors.forces import Forces
    from geograph.initialise import PathFit
    from geograph.losses import Loss
    from geograph.prepare import Prepared
    from geograph.recording import SmoothSettings

# The first knot's prior is this many distances wide: data that determine the path do not feel it.
_PRIOR_WIDTH = 100.0


def first_fits(
    prepared: Prepared, *, static: bool, orbital: bool = False, forces: Forces | None = None
) -> list[PathFit]:
    """Return first guesses of the path, the most promising of each kind of measurement first.

    Parameters
    ----------
    prepared
        The recording.
    static
        Whether the object stands still.
    orbital
        Whether it is in orbit: an orbit through all bearings, if there is one, is the one guess.
    forces
        What acts on it beside gravity.
    """
    recording = levelled(prepared.recording)
    fits: list[PathFit] = []
    if prepared.bearings is not None:
        finder = FirstGuess(
            prepared.bearings,
            recording.constraints,
            prepared.sensors,
            prepared.geometry,
            recording.propagation_speed_m_s,
            static,
        )
        if orbital and recording.frame == "ecef":
            from geograph.orbit_starts import orbit_fits

            fits += orbit_fits(finder, forces)
        above, terrain = ground_height(prepared.recording.constraints), recording.terrain
        if above is not None and terrain is not None:
            fits += terrain_fits(finder, terrain, above)
        if not fits:
            fits += finder.fits()
    if set(recording.tables) != {"bearings"}:
        from geograph.range_starts import range_fits

        fits += range_fits(recording, prepared.geometry, static=static)
    return fits


def resolution(prepared: Prepared, fit: PathFit) -> Resolution:
    """Return what the measurements resolve at the distances of a fit."""
    count, information, velocity, clock = 0, 0.0, 0.0, 0.0
    sigma_rad: list[float] = []
    for family in prepared.sensor_families():
        time = family.time_s - fit.clock_s[family.sensor]
        sensor = prepared.geometry.motion(family.sensor, time)
        state = fit.state(time, 2)
        distance = np.linalg.norm(state[:, :3] - sensor.position_m, axis=1)
        speed = np.linalg.norm(state[:, 3:] - sensor.velocity_m_s, axis=1)
        sigma = family.resolution_m(distance, speed)
        typical = float(np.median(sigma))
        information += len(family) / typical**2
        count += len(family)
        known = family.velocity_resolution_m_s()
        if known is not None:
            velocity += float(np.sum(known**-2.0))
        resolved = float(np.median(family.clock_resolution_s(distance, speed)))
        clock += len(family) / resolved**2
        if isinstance(family, BearingFamily):
            table = family.bearings
            angle = np.fmin(table.sigma_azimuth_rad, table.sigma_elevation_rad)
            sigma_rad.append(float(np.median(angle)))
        else:
            sigma_rad.append(typical / max(float(np.median(distance)), typical))
    span = prepared.span_s
    sigma_m = float(np.sqrt(count / information))
    return Resolution(count, span, sigma_m, min(sigma_rad), velocity / span, clock / span)


def start(
    prepared: Prepared, settings: SmoothSettings, fit: PathFit, loss: Loss
) -> tuple[Problem, Values, Resolution]:
    """Return the problem and the values that a first guess leads to, and what is resolved there.

    Parameters
    ----------
    prepared
        The recording.
    settings
        How it is smoothed.
    fit
        The first guess.
    loss
        Loss of each measurement.
    """
    order = Motion(settings.motion, Density.of(1.0), prepared.recording.frame).order
    resolved = resolution(prepared, fit)
    noise = settings.process_noise
    if noise == "auto":
        noise = guess_noise(fit, order, resolved)
    density = Density.of(noise, settings.process_noise_along)
    forces = forces_of(prepared.recording, settings)
    motion = Motion(settings.motion, density, prepared.recording.frame, forces)
    stages = None
    if isinstance(settings.stages, tuple) and not motion.static:
        stages = Stages.of(settings.stages)
    knots = choose_knots(
        prepared,
        settings,
        motion,
        times_s=_emission_times(prepared, fit),
        resolved=resolved,
        stages=stages,
    )
    unknown = np.zeros(0) if forces is None else forces.sigma
    state = np.concatenate([fit.state(knots, order), np.zeros((knots.size, unknown.size))], axis=1)
    span = prepared.span_s
    rank = np.repeat(np.arange(order, dtype=np.float64), 3)
    width = prior_width(max(fit.range_m, resolved.sigma_m), span, order)
    prior = PathPrior(state[0], np.concatenate([width, unknown]))
    # What the sensors may be off by is the unit of length, a tenth of the pass that of time.
    states = prepared.states
    scale = resolved.sigma_m * _blur(prepared, resolved) * (10.0 / span) ** rank
    constants = np.zeros(states.size)
    for column, entry in enumerate(states.constants):
        if entry.channel == CLOCK and not entry.drift:
            constants[column] = fit.clock_s[entry.sensor] / entry.sigma
    problem = Problem(
        motion=motion,
        knots_s=knots,
        families=prepared.families(knots),
        states=states,
        walk_scale=prepared.walk_scale,
        prior=prior,
        path_scale=np.concatenate([scale, unknown]),
        loss=loss,
        elimination=settings.elimination,
        shift=None if motion.static else prepared.shift,
        stages=stages,
    )
    values = Values(state, np.zeros((knots.size, states.chains)), constants)
    problem.refresh(values)
    return problem, values, resolved


def prior_width(reach_m: float, span_s: float, order: int) -> NDArray[np.float64]:
    """Return sigmas of the first knot's weak prior, shape (3m,), SI.

    Parameters
    ----------
    reach_m, span_s
        How far the object is, and for how long it is measured.
    order
        Blocks of the state.
    """
    rank = np.repeat(np.arange(order, dtype=np.float64), 3)
    return np.asarray(_PRIOR_WIDTH * reach_m * span_s**-rank)


def _blur(prepared: Prepared, resolved: Resolution) -> float:
    """Return by how much the sensors' constant errors exceed what one measurement resolves."""
    speed = prepared.recording.propagation_speed_m_s
    speed = speed if np.isfinite(speed) else SPEED_OF_LIGHT_M_S
    angles, lengths = [], []
    for state in prepared.states.constants:
        if state.drift:
            continue
        if state.channel <= ELEVATION or state.channel >= MISALIGNMENT:
            angles.append(state.sigma / resolved.sigma_rad)
        elif state.channel == CLOCK:
            lengths.append(state.sigma * speed / resolved.sigma_m)
        elif state.channel < POSITION + 3:
            lengths.append(state.sigma / resolved.sigma_m)
    if prepared.bearings is not None:
        # The clocks of angles only move their time tags.
        lengths = []
    biases = [float(np.median(part)) for part in (angles, lengths) if part]
    return float(np.hypot(1.0, max(biases, default=0.0)))


def _emission_times(prepared: Prepared, fit: PathFit) -> NDArray[np.float64]:
    """Return about when the signals of a fit were emitted, shape (n,)."""
    speed, found = prepared.recording.propagation_speed_m_s, []
    for family in prepared.sensor_families():
        # Times of differences are those of arrival at the reference.
        heard_by = family.sensor if family.reference is None else family.reference
        received = family.time_s - fit.clock_s[heard_by]
        emitted = received - fit.range_m / speed
        place = prepared.geometry.motion(heard_by, received).position_m
        distance = np.linalg.norm(fit.state(emitted, 1) - place, axis=1)
        found.append(received - distance / speed)
    return np.concatenate(found)


def choose_knots(
    prepared: Prepared,
    settings: SmoothSettings,
    motion: Motion,
    *,
    times_s: NDArray[np.float64],
    resolved: Resolution,
    stages: Stages | None = None,
) -> NDArray[np.float64]:
    """Return the knots' times, shape (K,), for given times of emission.

    Where a stage begins there is a knot, and each has the spacing that its noise asks for.

    Parameters
    ----------
    prepared
        The recording.
    settings
        With the spacing, if the user chose one.
    motion
        Motion with its noise.
    times_s
        Shape (n,).
    resolved
        What the measurements resolve.
    stages
        Multiples of the noise over time.
    """
    states = prepared.states
    if motion.static and not states.chains:
        return np.array([0.5 * (times_s.min() + times_s.max())])
    times = np.concatenate([times_s, prepared.fix_times()])
    if stages is None:
        return _even_knots(prepared, settings, motion, times, resolved)
    low, high = float(times.min()), float(times.max())
    inner = stages.from_s[(stages.from_s > low) & (stages.from_s < high)]
    edges = np.concatenate([[low], inner, [high]])
    found = []
    for first, last in pairwise(edges.tolist()):
        own = motion.scaled(float(stages.at(np.array([0.5 * (first + last)]))[0]))
        within = times[(times > first) & (times < last)]
        part = np.concatenate([[first], within, [last]])
        found.append(_even_knots(prepared, settings, own, part, resolved)[:-1])
    return np.concatenate([*found, [high]])


def _even_knots(
    prepared: Prepared,
    settings: SmoothSettings,
    motion: Motion,
    times: NDArray[np.float64],
    resolved: Resolution,
) -> NDArray[np.float64]:
    """Return knots that cover some times, all for the same noise."""
    states = prepared.states
    spacing = settings.spacing_s
    automatic = spacing is None
    if spacing is None:
        spacing = automatic_spacing(motion, states, resolved)
    elif motion.ballistic:
        spacing = min(spacing, motion.longest_step_s)
    unknowns = 2 * (motion.size + states.chains) + states.size + 1
    count = float(np.ptp(times)) / spacing
    if automatic:
        # The knots at the times themselves, and those in the gaps between.
        count = min(count, times.size + float(np.ptp(times)) / motion.longest_step_s)
    check_memory(count, unknowns, spacing)
    return place_knots(times, spacing, automatic=automatic, longest_s=motion.longest_step_s)
