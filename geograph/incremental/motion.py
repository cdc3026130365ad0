"""Motion models by name, for those who build a smoother in Python."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

if TYPE_CHECKING:
    from geograph.recording import MotionName

Noise = float | tuple[float, float, float] | Literal["auto"]


@dataclass(frozen=True)
class MotionSpec:
    """A motion model and the noise that drives it.

    Parameters
    ----------
    process_noise, process_noise_along
        As in :class:`geograph.SmoothSettings`.
    """

    name: ClassVar[MotionName]
    process_noise: Noise = "auto"
    process_noise_along: float | None = None

    def settings(self) -> dict[str, Any]:
        """Return the settings that it stands for."""
        return {
            "motion": self.name,
            "process_noise": self.process_noise,
            "process_noise_along": self.process_noise_along,
        }


class Static(MotionSpec):
    """An object that stands still."""

    name = "static"


class ConstantPosition(MotionSpec):
    """White noise on the velocity, m/s^0.5."""

    name = "constant-position"


class ConstantVelocity(MotionSpec):
    """White noise on the acceleration, m/s^1.5."""

    name = "constant-velocity"


class ConstantAcceleration(MotionSpec):
    """White noise on the jerk, m/s^2.5."""

    name = "constant-acceleration"


class Ballistic(MotionSpec):
    """Free fall, with white noise on the acceleration, m/s^1.5."""

    name = "ballistic"
