"""The incremental smoother: measurements in as they arrive, the newest estimate out.

An update works on a copy of lists whose entries are never changed, and the copy takes the place of
what was there in one assignment at its end: whatever is thrown in between, the smoother is what it
was.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geograph.constants import SPEED_OF_LIGHT_M_S
from geograph.errors import GeographError, InputError, UpdateError, told
from geograph.incremental.advance import advance
from geograph.incremental.estimate import Estimate, Tracking
from geograph.incremental.model import SpanError
from geograph.incremental.remake import change_noise, collect, finished, renew, restart
from geograph.incremental.report import held_track, newest_covariance, newest_errors
from geograph.incremental.review import check, look_over
from geograph.incremental.rows import Emissions, count, join, keys, read
from geograph.incremental.start import NotStartedError
from geograph.incremental.state import State, row_names, without_duplicates
from geograph.orbit_forces import forces_of
from geograph.recording import Recording, SmoothSettings
from geograph.threads import single_blas_thread

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from datetime import datetime

    from geograph.incremental.motion import MotionSpec
    from geograph.incremental.rows import Rows
    from geograph.measurements import Constraints, Measurements
    from geograph.recording import Frame, MotionName
    from geograph.sensors import Sensor
    from geograph.terrain import Terrain
    from geograph.track import Track

_log = logging.getLogger("geograph.incremental")

_TRIES = 4

EngineName = Literal["structured", "isam2"]


class IncrementalSmoother:
    """Estimate an object's path while it is being measured.

    Parameters
    ----------
    sensors
        By name; their order is that of the sensor indices in the tables.
    motion
        Motion model with its noise, for example ``ConstantAcceleration(10.0)``, or its name, with
        the noise of ``settings``; None: that of ``settings``.
    frame, epoch, propagation_speed_m_s, propagation_sigma_m_s
        As of a :class:`geograph.Recording`.
    terrain
        Ground that constraints count heights from, or None.
    lag
        Seconds that are held; what is older stays as a prior. None: everything is held.
    settings
        The other settings; the defaults of :class:`geograph.SmoothSettings`.
    engine
        ``"structured"`` or ``"isam2"``: who solves the linear systems.
    **changes
        Single settings by name, over those above.

    Raises
    ------
    InputError
        If a setting is wrong.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        *,
        motion: MotionSpec | MotionName | None = None,
        frame: Frame = "ecef",
        epoch: datetime | None = None,
        propagation_speed_m_s: float = SPEED_OF_LIGHT_M_S,
        propagation_sigma_m_s: float = 0.0,
        terrain: Terrain | None = None,
        lag: float | None = None,
        settings: SmoothSettings | None = None,
        engine: EngineName = "structured",
        **changes: Any,
    ) -> None:
        chosen = (settings or SmoothSettings()).replace(**changes)
        if isinstance(motion, str):
            chosen = chosen.replace(motion=motion)
        elif motion is not None:
            chosen = chosen.replace(**motion.settings())
        if lag is not None and not (np.isfinite(lag) and lag > 0.0):
            raise InputError(f"lag is {lag}; expected seconds above 0, or None", column="lag")
        if engine not in ("structured", "isam2"):
            raise InputError(
                f"unknown engine {engine!r}; expected structured or isam2", column="engine"
            )
        if engine == "isam2" and chosen.motion == "static":
            raise InputError(
                "engine is isam2, and an object that stands still has no process noise, which "
                "GTSAM cannot whiten; expected engine structured",
                column="engine",
            )
        if chosen.stages is not None:
            raise InputError(
                "stages are found or given for whole recordings alone; expected none: leave them "
                "out (--stages none), and where the noise changes call change_process_noise",
                column="stages",
            )
        for sensor in sensors.values():
            if sensor.calibrations_s == "auto":
                raise InputError(
                    f"sensor {sensor.name!r} has calibrations_s = auto, which only the batch "
                    "smoother finds; expected their times, or an instability in their place",
                    column="calibrations_s",
                )
        template = Recording(
            name="feed",
            frame=frame,
            sensors=dict(sensors),
            epoch=epoch,
            propagation_speed_m_s=propagation_speed_m_s,
            propagation_sigma_m_s=propagation_sigma_m_s,
            terrain=terrain,
            settings=chosen,
        )
        forces_of(template, chosen)  # refuses now what could not be used later
        self._state = State(template, chosen, lag, engine == "isam2")
        self._known: set[Any] = set()
        self._emissions = Emissions()
        self._next = 0
        self._estimate = Estimate(
            status=Tracking.COLLECTING, message=self._state.message, frame=frame
        )

    @classmethod
    def of(
        cls,
        recording: Recording,
        *,
        lag: float | None = None,
        engine: EngineName = "structured",
        **changes: Any,
    ) -> IncrementalSmoother:
        """Return a smoother for the sensors, frame and settings of a recording.

        Its measurements are not used.

        Parameters
        ----------
        recording
            The recording.
        lag, engine, **changes
            As of the class.
        """
        return cls(
            recording.sensors,
            frame=recording.frame,
            epoch=recording.epoch,
            propagation_speed_m_s=recording.propagation_speed_m_s,
            propagation_sigma_m_s=recording.propagation_sigma_m_s,
            terrain=recording.terrain,
            lag=lag,
            settings=recording.settings,
            engine=engine,
            **changes,
        )

    @property
    def estimate(self) -> Estimate:
        """The newest estimate, without work."""
        return self._estimate

    def update(
        self, measurements: Measurements | Constraints | Iterable[Measurements | Constraints]
    ) -> Estimate:
        """Use measurements, in any order.

        Parameters
        ----------
        measurements
            One table, or several.

        Returns
        -------
        estimate
            The newest.

        Raises
        ------
        UpdateError
            If it could not be done; the smoother is then what it was.
        """
        try:
            with single_blas_thread():
                return self._update(measurements)
        except GeographError:
            raise
        except Exception as error:
            raise UpdateError(
                f"update failed ({told(error)}); nothing of it was used: give "
                "its measurements one by one to find the one that is to blame"
            ) from error

    def _update(
        self, measurements: Measurements | Constraints | Iterable[Measurements | Constraints]
    ) -> Estimate:
        self._emissions.begin()
        state = self._state.afresh(share=True)
        rows = read(
            measurements,
            sensors=len(state.template.sensors),
            first=self._next,
            emissions=self._emissions,
        )
        following = self._next + count(rows)
        rows, again, added = without_duplicates(self._known, rows)
        state.newly_duplicate = again
        state.duplicates += count(again)
        rows = self._whole(state, rows)
        state.total += count({k: c for k, c in rows.items() if "sensor" in c})
        if state.chain is None:
            collect(state, rows)
        elif rows:
            state = self._advance(state, rows)
        estimate = self._told(state)
        self._commit(state, estimate, added, following)
        return estimate

    def _whole(self, state: State, rows: Rows) -> Rows:
        """Set aside what holds along the whole path."""
        from geograph.incremental.rows import CONSTRAINTS, choose

        part = {k: c for k, c in rows.items() if k in CONSTRAINTS}
        if not part:
            return rows
        if state.chain is None and not part.keys() <= state.whole.keys() | state.waiting.keys():
            # A height, say, may be what a start was missing.
            state.tried = 0
        chosen = {k: np.isnan(c["time_s"]) for k, c in part.items()}
        if not any(mask.any() for mask in chosen.values()):
            return rows
        state.whole = join([state.whole, choose(part, chosen)])
        if state.model is not None:
            state.model = replace(state.model, whole=state.whole, whole_s=0.0)
            _, chain = state.running
            state.chain = chain.copy()
            look_over(state)
        left = choose(part, {k: ~mask for k, mask in chosen.items()})
        return {k: c for k, c in rows.items() if k not in CONSTRAINTS} | left

    def _advance(self, state: State, rows: Rows) -> State:
        """Use rows; where the linear system does not bear them, make it anew."""
        reason = ""
        reach = None
        for _ in range(_TRIES):
            attempt = state.copy()
            attempt.reach_s = reach
            try:
                advance(attempt, rows)
            except SpanError as error:
                # A clock moved, and with it the newest emission.
                reason, reach = str(error), error.high_s
            except (ArithmeticError, np.linalg.LinAlgError) as error:
                reason = told(error)
                break
            else:
                return attempt
        return self._rebuilt(state, rows, reason)

    def _rebuilt(self, state: State, rows: Rows, reason: str) -> State:
        """Make the linear system anew, from the estimate or from a first guess."""
        _log.warning("the linear system is made anew (%s)", reason)
        for way in (renew, restart):
            attempt = state.copy()
            attempt.rebuilt += 1
            try:
                way(attempt, rows)
            except (ArithmeticError, np.linalg.LinAlgError, NotStartedError) as error:
                reason = f"{reason}; {told(error)}"
            else:
                return attempt
        raise UpdateError(
            "the measurements do not go with what is held, and there is no new start with them; "
            f"none of them was used ({reason})"
        )

    def _commit(
        self,
        state: State,
        estimate: Estimate,
        added: Iterable[Any],
        following: int,
    ) -> None:
        """Take over what an update made; nothing in here can fail."""
        gone = [k for rows in state.dropped for kind, c in rows.items() for k in keys(kind, c)]
        silent = [r["arrivals"]["emission"].tolist() for r in state.dropped if "arrivals" in r]
        state.dropped = []
        self._known.update(added)
        self._known.difference_update(gone)
        self._state, self._estimate = state, estimate
        self._emissions.commit(number for numbers in silent for number in numbers)
        self._next = following

    def _told(self, state: State) -> Estimate:
        """Return the estimate of a state."""
        template = state.template
        named = {
            name: tuple(entry for kind, c in rows.items() for entry in row_names(template, kind, c))
            for name, rows in (
                ("duplicates", state.newly_duplicate),
                ("late", state.newly_late),
            )
        }
        waiting = tuple(state.names[i] for i, judged in state.out.items() if not judged)
        rejected = tuple(state.names[i] for i, judged in state.out.items() if judged)
        common: dict[str, Any] = {
            **named,
            "frame": template.frame,
            "waiting": waiting,
            "rejected": rejected,
            "duplicate_count": state.duplicates,
            "late_count": state.late,
            "rejected_count": state.rejected_before + len(rejected),
            "rebuilt": state.rebuilt,
        }
        if state.chain is None:
            return Estimate(status=Tracking.COLLECTING, message=state.message, **common)
        _, chain = state.running
        covariance, newest = newest_covariance(state), chain.path[-1]
        if not isfinite(float(covariance.sum()) + float(newest.sum())):
            raise FloatingPointError("the estimate is not finite")
        return Estimate(
            status=Tracking.TRACKING,
            message=_message(len(waiting)),
            time_s=chain.knots_s[-1],
            state=newest[: len(covariance)],
            covariance=covariance,
            sensor_errors=newest_errors(state),
            knots=len(chain.knots_s),
            used=state.total - state.late - state.rejected_before - len(state.out),
            **common,
        )

    def change_process_noise(
        self,
        process_noise: float | tuple[float, float, float] | Literal["auto"],
        process_noise_along: float | None = None,
    ) -> None:
        """Let another noise drive the path from the newest knot on, and stay what was before.

        For an object that begins or ends a manoeuvre, say. Afterwards measurements from before the
        oldest knot but one are too late, and between knots :meth:`track` gives covariances of the
        new noise.

        Parameters
        ----------
        process_noise, process_noise_along
            As in :class:`geograph.SmoothSettings`; ``"auto"`` is found at starts alone.

        Raises
        ------
        InputError
            If it is no finite number above 0, or the object stands still.
        UpdateError
            If it could not be done; the smoother is then what it was.
        """
        if process_noise == "auto":
            raise InputError(
                "process_noise is 'auto', which is found at the start; expected a number",
                column="process_noise",
            )
        if self._state.settings.motion == "static":
            raise InputError(
                "an object that stands still has no process noise; expected another motion",
                column="motion",
            )
        settings = self._state.settings.replace(
            process_noise=process_noise, process_noise_along=process_noise_along
        )
        with single_blas_thread():
            state = self._state.afresh()
            try:
                change_noise(state, settings)
                estimate = self._told(state)
            except ArithmeticError as error:
                raise UpdateError(
                    f"the process noise could not be changed ({told(error)})"
                ) from error
        self._commit(state, estimate, (), self._next)

    def track(self) -> Track:
        """Return all knots that are held, with their covariances.

        Raises
        ------
        UpdateError
            If there is none yet.
        """
        if self._state.chain is None:
            raise UpdateError(f"there is no track yet: {self._state.message}")
        with single_blas_thread():
            state = self._state.copy()
            look_over(state)
            check(state)
            return held_track(state)

    def finish(self) -> Estimate:
        """Decide about what still waits, and solve for everything that is held once more.

        Raises
        ------
        UpdateError
            If that failed; the smoother is then what it was.
        """
        try:
            with single_blas_thread():
                state = self._state.afresh()
                finished(state)
                estimate = self._told(state)
                self._commit(state, estimate, (), self._next)
                return estimate
        except GeographError:
            raise
        except Exception as error:
            raise UpdateError(f"finish failed ({told(error)})") from error


def _message(waiting: int) -> str:
    if waiting:
        return f"tracking; {waiting} measurements do not fit and wait for others to judge them"
    return "tracking"
