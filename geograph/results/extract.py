"""From a track, which holds the whole posterior, to the results that files hold of it."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph.results.data import (
    ELLIPSOID_PROBABILITY,
    ErrorCurve,
    ErrorKind,
    ErrorState,
    ResidualTable,
    Results,
    SensorPath,
)
from geograph.results.platforms import platform_paths
from geograph.states import CHANNEL_NAMES

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from geograph.recording import Recording
    from geograph.sensors import Sensor, SensorErrors
    from geograph.track import Track

_CURVE_POINTS = 200
_ERROR_UNITS: dict[ErrorKind, str] = {
    "azimuth": "rad",
    "elevation": "rad",
    "clock": "s",
    "frequency": "Hz",
}


def from_track(track: Track, *, command: str | None = None) -> Results:
    """Return the results of a track.

    Parameters
    ----------
    track
        As :func:`geograph.smooth` returned it.
    command
        Command line to be noted in the summary.
    """
    recording = track.recording
    start, end = recording.time_span_s
    sensors = recording.sensors.values()
    return Results(
        name=recording.name,
        frame=recording.frame,
        status=track.status.value,
        time_s=track.time_s,
        position_m=track.position_m,
        position_covariance_m2=track.position_covariance_m2,
        velocity_m_s=track.velocity_m_s,
        acceleration_m_s2=track.acceleration_m_s2,
        sigma_speed_m_s=_speed_sigma(track),
        semi_axes_m=track.ellipsoids(ELLIPSOID_PROBABILITY).semi_axes_m,
        sensors=tuple(_sensor_path(sensor, start, end) for sensor in sensors),
        platforms=platform_paths(track),
        errors=tuple(
            ErrorState(
                sensor=sensor,
                state=state,
                unit=estimate.unit,
                estimate=float(estimate.estimate),
                sigma=float(estimate.sigma),
                prior_sigma=float(estimate.prior_sigma),
            )
            for sensor, states in track.sensor_errors.items()
            for state, estimate in states.items()
        ),
        curves=tuple(
            _curve(track, sensor, kind, start, end)
            for sensor in sensors
            for kind in _ERROR_UNITS
            if _changes(track, sensor, kind)
        ),
        residuals=_residual_table(track),
        truth=recording.truth,
        summary=_summary(track, command),
        motion_covariance=_motion_covariance(track),
    )


def _motion_covariance(track: Track) -> NDArray[np.float64] | None:
    if track.order < 2:
        return None
    # Of either triangle, which differ by rounding, files keep the upper one.
    upper = np.triu(track.covariance[:, :6, :6])
    return np.asarray(upper + np.swapaxes(np.triu(upper, 1), 1, 2))


def as_results(track: Track | Results) -> Results:
    """Return results as they are, or those of a track."""
    return track if isinstance(track, Results) else from_track(track)


def versions() -> dict[str, str]:
    """Return the versions of geograph, of what it computes with, and of Python."""
    import platform
    from importlib.metadata import version

    packages = ("geograph", "gtsam", "numpy", "scipy")
    return {name: version(name) for name in packages} | {"python": platform.python_version()}


def _summary(track: Track, command: str | None) -> dict[str, Any]:
    recording = track.recording
    start, end = recording.time_span_s
    facts: dict[str, Any] = dict(track.summary)
    facts.setdefault("name", recording.name)
    facts.setdefault("status", track.status.value)
    facts["frame"] = recording.frame
    facts["epoch"] = None if recording.epoch is None else recording.epoch.isoformat()
    facts["time_span_s"] = [start, end]
    facts["propagation_speed_m_s"] = recording.propagation_speed_m_s
    facts["height_held"] = height_held(recording)
    facts["rejected"] = _with_emissions(facts.get("rejected", ()), recording)
    facts["ellipsoid_probability"] = ELLIPSOID_PROBABILITY
    facts["settings"] = dataclasses.asdict(track.settings)
    facts["versions"] = versions()
    facts["command"] = command
    return facts


def height_held(recording: Recording) -> bool:
    """Return whether the whole path is held to one height of a local frame."""
    held = recording.constraints
    if recording.frame != "local" or held is None:
        return False
    pairs = zip(held.kind, held.time_s, strict=True)
    return any(kind in ("altitude_m", "z_m") and np.isnan(time) for kind, time in pairs)


def _emissions(recording: Recording) -> dict[tuple[str, float], str]:
    """Return what each arrival's emission is called, by sensor and arrival time."""
    table = recording.arrivals
    if table is None:
        return {}
    names, labels = recording.sensor_names, table.emission_names
    rows = zip(table.sensor.tolist(), table.toa_s.tolist(), table.emission.tolist(), strict=True)
    return {
        (names[sensor], time): labels[emission] if labels else str(emission)
        for sensor, time, emission in rows
    }


def _with_emissions(
    rejected: Iterable[dict[str, Any]], recording: Recording
) -> list[dict[str, Any]]:
    """Return rejected measurements, those that are arrivals with their emissions."""
    known = _emissions(recording)
    return [
        entry | {"emission": known[entry["sensor"], entry["time_s"]]}
        if entry.get("table") == "arrivals"
        else entry
        for entry in rejected
    ]


def _speed_sigma(track: Track) -> NDArray[np.float64] | None:
    velocity = track.velocity_m_s
    if velocity is None:
        return None
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    # At rest the direction is undefined; any unit vector then gives the right order of magnitude.
    along = np.where(speed > 0.0, velocity, [1.0, 0.0, 0.0]) / np.where(speed > 0.0, speed, 1.0)
    variance = np.einsum("ki,kij,kj->k", along, track.covariance[:, 3:6, 3:6], along)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _sensor_path(sensor: Sensor, start: float, end: float) -> SensorPath:
    time = np.array([start])
    if sensor.trajectory is not None:
        if sensor.platform_process_noise is not None:
            # Its fixes themselves: a curve through their noise is nowhere that it was.
            return SensorPath(
                sensor=sensor.name,
                axes=sensor.axes,
                time_s=sensor.trajectory.time_s,
                position_m=sensor.trajectory.position_m,
            )
        low, high = sensor.trajectory.time_s[[0, -1]]
        time = np.linspace(max(start, low), min(end, high), _CURVE_POINTS)
    position = np.array(sensor.position_at(time))
    return SensorPath(sensor=sensor.name, axes=sensor.axes, time_s=time, position_m=position)


def _changes(track: Track, sensor: Sensor, kind: ErrorKind) -> bool:
    """Return whether an error was estimated, which a sensor without measurements has not."""
    estimated = track.sensor_errors.get(sensor.name, {})
    changing = (f"{kind}_{what}" for what in ("drift", "walk", "bias_2", "offset_2"))
    return any(name in estimated for name in changing)


def _prior(errors: SensorErrors, kind: ErrorKind) -> tuple[float, float, float]:
    if kind == "clock":
        return errors.clock_offset_s, errors.clock_drift_s_s, errors.clock_instability_s_sqrt_s
    if kind == "frequency":
        return errors.frequency_offset_hz, errors.frequency_drift_hz_s, 0.0
    return (
        getattr(errors, f"{kind}_bias_rad"),
        getattr(errors, f"{kind}_drift_rad_s"),
        getattr(errors, f"{kind}_instability_rad_sqrt_s"),
    )


def _curve(track: Track, sensor: Sensor, kind: ErrorKind, start: float, end: float) -> ErrorCurve:
    index = track.recording.sensor_names.index(sensor.name)
    resets = track.problem.states.stretches.of(index, CHANNEL_NAMES.index(kind))
    resets = resets[(resets > start) & (resets <= end)]
    # On both sides of a reset, so that it is seen as a jump.
    sides = np.concatenate([np.nextafter(resets, -np.inf), resets])
    time = np.unique(np.concatenate([np.linspace(start, end, _CURVE_POINTS), sides]))
    estimate, sigma = track.sensor_error_at(sensor.name, kind, time)
    bias, drift, instability = _prior(sensor.errors, kind)
    begun = np.concatenate([[start], resets])
    elapsed = time - begun[np.searchsorted(resets, time, side="right")]
    prior = np.sqrt(bias**2 + (drift * elapsed) ** 2 + instability**2 * elapsed)
    return ErrorCurve(
        sensor=sensor.name,
        kind=kind,
        unit=_ERROR_UNITS[kind],
        time_s=time,
        estimate=estimate,
        sigma=sigma,
        prior_sigma=prior,
    )


def _residual_table(track: Track) -> ResidualTable:
    source = track.residuals
    names = np.asarray(track.recording.sensor_names, dtype=np.str_)
    sensor = names[np.asarray(source.sensor, dtype=np.int64)]
    reference = np.where(source.reference >= 0, names[source.reference], "")
    kind = np.asarray(source.kind, dtype=np.str_)
    known = _emissions(track.recording)
    arrivals = zip(kind.tolist(), sensor.tolist(), source.time_s.tolist(), strict=True)
    emission = [known[name, time] if what == "toa" else "" for what, name, time in arrivals]
    return ResidualTable(
        time_s=source.time_s,
        sensor=sensor,
        reference=reference,
        emission=np.array(emission, dtype=np.str_),
        kind=kind,
        unit=np.asarray(source.unit, dtype=np.str_),
        measured=source.measured,
        predicted=source.predicted,
        residual=source.residual,
        sigma=source.sigma,
        normalised=source.normalised,
        weight=source.weight,
        rejected=source.rejected,
        line=source.line,
    )
