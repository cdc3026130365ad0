"""Motion models: the Gaussian-process prior of the path between knots.

A prior turns two neighbouring knots' states into white residuals of unit variance, and says how the
later state follows from the earlier one and the noise:

    x[k+1] = f(x[k]) + L w[k],    w[k] of unit covariance,

with f a Taylor polynomial (constant position, velocity, acceleration) or free fall (ballistic,
orbital). What is unknown of the forces on a satellite stands behind the velocity, and hardly
changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from geograph.errors import InputError
from geograph.factors.kinematics import (
    interpolation_matrices,
    noise_covariance,
    noise_square_root,
    spatial_square_root,
    spatial_square_root_derivative,
    transition,
    unit_noise_square_root,
)
from geograph.kernels import compiled, flat
from geograph.path import BallisticPath, KinematicPath, Order, Path, fall

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geograph.factors.forces import Forces
    from geograph.factors.gravity import Degree
    from geograph.recording import Frame, MotionName

_ORDERS: dict[str, Order] = {
    "static": 1,
    "constant-position": 1,
    "constant-velocity": 2,
    "constant-acceleration": 3,
    "ballistic": 2,
    "orbital": 2,
}


@dataclass(frozen=True)
class Density:
    """Square root of the spectral density of the noise that drives a motion.

    Attributes
    ----------
    axes
        Along x, y and z of the frame, or across the velocity (then all alike).
    along
        Along the velocity; None: the noise does not follow the velocity.
    """

    axes: tuple[float, float, float]
    along: float | None = None

    @classmethod
    def of(cls, noise: float | tuple[float, float, float], along: float | None = None) -> Density:
        """Return the density of a setting; see :class:`geograph.SmoothSettings`."""
        axes = noise if isinstance(noise, tuple) else (noise, noise, noise)
        return cls(axes, along)

    @property
    def largest(self) -> float:
        """The greatest of its values."""
        return max(*self.axes, self.along or 0.0)

    def scaled(self, factor: float) -> Density:
        """Return all values multiplied by a factor."""
        x, y, z = (factor * value for value in self.axes)
        return Density((x, y, z), None if self.along is None else factor * self.along)

    def square_root(
        self, velocity_m_s: NDArray[np.float64] | None, count: int
    ) -> NDArray[np.float64]:
        """Return the spatial square roots, shape (n, 3, 3)."""
        if self.along is None or velocity_m_s is None:
            return np.broadcast_to(np.diag(self.axes), (count, 3, 3))
        return spatial_square_root(velocity_m_s, self.axes[0], self.along)

    def inverse_square_root(
        self, velocity_m_s: NDArray[np.float64] | None, count: int
    ) -> NDArray[np.float64]:
        """Return the inverses of the spatial square roots, shape (n, 3, 3)."""
        if self.along is None or velocity_m_s is None:
            return np.broadcast_to(np.diag(1.0 / np.array(self.axes)), (count, 3, 3))
        return spatial_square_root(velocity_m_s, 1.0 / self.axes[0], 1.0 / self.along)


@dataclass(frozen=True, eq=False)
class Transitions:
    """All transitions between knots, linearised; SI units, m' components each.

    Attributes
    ----------
    residual
        Shape (K - 1, m'): whitened, w[k] = L^-1 (x[k+1] - f(x[k])).
    transition
        Shape (K - 1, m', m'): derivative of x[k+1] by x[k] at fixed w[k].
    noise_root
        Shape (K - 1, m', m'): L.
    """

    residual: NDArray[np.float64]
    transition: NDArray[np.float64]
    noise_root: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearTransitions:
    """All transitions between knots as the elimination takes them; scaled.

    Attributes
    ----------
    inverse, noise_root
        Shape (K - 1, 3m, 3m): F^-1 and L.
    residual
        Shape (K - 1, 3m): w.
    """

    inverse: NDArray[np.float64]
    noise_root: NDArray[np.float64]
    residual: NDArray[np.float64]


class Motion:
    """A motion model with its noise.

    Parameters
    ----------
    name
        One of the names of :class:`geograph.SmoothSettings`.
    density
        Noise density; ignored by ``static``.
    frame
        Frame of the recording, which the ballistic model needs.
    forces
        What acts on a satellite beside gravity; None: nothing.

    Attributes
    ----------
    order
        Blocks of three in the state that derive from each other: position, velocity, acceleration.
    size
        Components of the state: 3 for each of these, and the unknowns of the forces.
    """

    def __init__(
        self, name: MotionName, density: Density, frame: Frame, forces: Forces | None = None
    ) -> None:
        self.name: MotionName = name
        self.order: Order = _ORDERS[name]
        self.density = density
        self.frame: Literal["ecef", "local"] = frame
        self.static = name == "static"
        self.ballistic = name in ("ballistic", "orbital")
        self.degree: Degree = 4 if name == "orbital" else 2
        self.forces = forces
        self.size = 3 * self.order + (0 if forces is None else len(forces.names))
        # Whether transitions and their noise are the same wherever the object is.
        self.constant = not self.ballistic and density.along is None
        if density.along is not None and self.order == 1:
            raise InputError("noise along the velocity needs a motion that has a velocity")

    def with_density(self, density: Density) -> Motion:
        """Return the same motion with other noise."""
        return Motion(self.name, density, self.frame, self.forces)

    def scaled(self, factor: float) -> Motion:
        """Return the same motion with its noise multiplied."""
        return self.with_density(self.density.scaled(factor))

    def path(self, knots_s: NDArray[np.float64]) -> Path:
        """Return the path of this motion over given knots, shape (K,)."""
        if self.ballistic:
            return BallisticPath(knots_s, self.frame, self.degree, self.forces)
        return KinematicPath(knots_s, self.order)

    @property
    def longest_step_s(self) -> float:
        """Longest interval that the path's interpolation is accurate over, seconds."""
        return BallisticPath.LONGEST_STEP_S if self.ballistic else float("inf")

    def read(
        self, path: Path, state: NDArray[np.float64], time_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return whole states of a path at any times, shape (n, size), SI units.

        Parameters
        ----------
        path
            A path of this motion.
        state
            Shape (K, size): states of its knots.
        time_s
            Shape (n,); times outside the knots are predicted from the nearer one.
        """
        knots = path.knots_s
        if knots.size == 1:
            return np.broadcast_to(state[0], (time_s.size, state.shape[1])).copy()
        place = path.locate(np.clip(time_s, knots[0], knots[-1]))
        held = path.at_state(state, jacobian=False)
        blocks = list(held.position_velocity(place)[: min(self.order, 2)])
        if self.order == 3:
            weights = interpolation_matrices(3, place.step_s, place.offset_s)[:, 2]
            pair = np.concatenate([state[:-1], state[1:]], axis=1)[place.interval]
            blocks.append(np.einsum("nj,njc->nc", weights, pair.reshape(-1, 6, 3)))
        if self.size > 3 * self.order:
            blocks.append(state[place.interval, 3 * self.order :])
        result = np.concatenate(blocks, axis=1)
        for outside, end in ((time_s < knots[0], 0), (time_s > knots[-1], -1)):
            if outside.any():
                step = time_s[outside] - knots[end]
                start = np.broadcast_to(state[end], (step.size, state.shape[1]))
                result[outside] = self.carried(start, step, np.full(step.size, knots[end]))
        return result

    def predict(
        self,
        state: NDArray[np.float64],
        step_s: NDArray[np.float64],
        start_s: NDArray[np.float64] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return f(x), shape (n, size), and its derivative, shape (n, size, size).

        Parameters
        ----------
        state
            Shape (n, size), SI units.
        step_s
            Shape (n,), seconds.
        start_s
            Shape (n,): when each step starts, which forces may depend on; with none, not needed.
        """
        if self.ballistic:
            return fall(state, step_s, self.frame, self.degree, forces=self.forces, start_s=start_s)
        eye = np.broadcast_to(np.eye(3), (step_s.size, 3, 3))
        by_block = transition(self.order, step_s)
        return self._taylor(by_block, state), kron_stack(by_block, eye)

    def carried(
        self,
        state: NDArray[np.float64],
        step_s: NDArray[np.float64],
        start_s: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Return f(x) alone, shape (n, size); see :meth:`predict`."""
        if self.ballistic:
            return self.predict(state, step_s, start_s)[0]
        return self._taylor(transition(self.order, step_s), state)

    def _taylor(
        self, by_block: NDArray[np.float64], state: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return states moved by transition matrices of one axis, shape (n, m, m)."""
        blocks = state.reshape(-1, self.order, 3)
        return np.asarray(np.matmul(by_block, blocks).reshape(state.shape))

    def noise(self, state: NDArray[np.float64], step_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance that noise adds over a step, shape (n, size, size), SI units."""
        if self.static:
            return np.zeros((step_s.size, 3, 3))
        root = self.density.square_root(self._velocity(state), step_s.size)
        unit = noise_covariance(self.order, step_s)
        return self._with_forces(kron_stack(unit, root @ np.swapaxes(root, -1, -2)), step_s, 2.0)

    def _with_forces(
        self, matrix: NDArray[np.float64], step_s: NDArray[np.float64], power: float
    ) -> NDArray[np.float64]:
        """Return matrices of the path with the wander of the forces' unknowns, to a power."""
        if self.forces is None or self.size == 3 * self.order:
            return matrix
        known = 3 * self.order
        whole = np.zeros((step_s.size, self.size, self.size))
        whole[:, :known, :known] = matrix
        extra = np.arange(known, self.size)
        whole[:, extra, extra] = self.forces.wander(step_s) ** power
        return whole

    def _velocity(self, state: NDArray[np.float64]) -> NDArray[np.float64] | None:
        return state[:, 3:6] if self.order > 1 else None

    def transitions(
        self,
        state: NDArray[np.float64],
        steps_s: NDArray[np.float64],
        start_s: NDArray[np.float64] | None = None,
    ) -> Transitions:
        """Linearise all transitions of a path.

        Parameters
        ----------
        state
            Shape (K, size): states of the knots.
        steps_s
            Shape (K - 1,): intervals between them.
        start_s
            Shape (K - 1,): when each starts; see :meth:`predict`.
        """
        first, second = state[:-1], state[1:]
        count, size = first.shape[0], 3 * self.order
        predicted, matrix = self.predict(first, steps_s, start_s)
        if self.static:
            return Transitions(np.zeros((count, size)), matrix, np.zeros((count, size, size)))
        velocity = self._velocity(first)
        unit_root = noise_square_root(self.order, steps_s)
        root = kron_stack(unit_root, self.density.square_root(velocity, count))
        gap = second - predicted
        by_block = gap[:, :size].reshape(count, self.order, 3)
        miss = np.asarray(np.linalg.solve(unit_root, by_block), dtype=np.float64)
        inverse = self.density.inverse_square_root(velocity, count)
        residual = (miss @ np.swapaxes(inverse, -1, -2)).reshape(count, size)
        along = self.density.along
        if along is not None and velocity is not None:
            # The whitening turns with the velocity: at fixed w that, too, moves x[k+1].
            turning = spatial_square_root_derivative(
                velocity, 1.0 / self.density.axes[0], 1.0 / along, miss
            ).reshape(count, size, 3)
            matrix = matrix.copy()
            matrix[:, :size, 3:6] -= root @ turning
        if self.forces is not None and self.size > size:
            wander = gap[:, size:] / self.forces.wander(steps_s)
            residual = np.concatenate([residual, wander], axis=1)
        return Transitions(residual, matrix, self._with_forces(root, steps_s, 1.0))

    def linear(
        self,
        state: NDArray[np.float64],
        steps_s: NDArray[np.float64],
        scale: NDArray[np.float64],
        start_s: NDArray[np.float64] | None = None,
    ) -> LinearTransitions:
        """Return what an elimination needs of all transitions, scaled.

        Parameters
        ----------
        state, steps_s, start_s
            As of :meth:`transitions`.
        scale
            Shape (size,): scales of the path's components, SI.
        """
        count, size = steps_s.size, scale.size
        if self._compiles:
            found = LinearTransitions(
                np.zeros((count, size, size)),
                np.zeros((count, size, size)),
                np.empty((count, size)),
            )
            self._run(state, steps_s, scale, found.inverse, found.noise_root, found.residual)
            return found
        plain = self.transitions(state, steps_s, start_s)
        return LinearTransitions(
            inverse_stack(plain.transition * scale / scale[:, None]),
            plain.noise_root / scale[:, None],
            plain.residual,
        )

    def residual(
        self,
        state: NDArray[np.float64],
        steps_s: NDArray[np.float64],
        start_s: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Return the whitened residuals of all transitions, shape (K - 1, size)."""
        if not self._compiles:
            return self.transitions(state, steps_s, start_s).residual
        found = np.empty((steps_s.size, 3 * self.order))
        self._run(state, steps_s, np.ones(3 * self.order), None, None, found)
        return found

    @property
    def _compiles(self) -> bool:
        """Whether compiled code knows this motion."""
        return compiled is not None and self.constant and not self.static

    def _run(
        self,
        state: NDArray[np.float64],
        steps_s: NDArray[np.float64],
        scale: NDArray[np.float64],
        *results: NDArray[np.float64] | None,
    ) -> None:
        compiled.kinematics(
            steps_s.size,
            self.order,
            unit_noise_square_root(self.order),
            *map(flat, (self.density.axes, scale, steps_s, state)),
            *results,
        )

    def cost(
        self,
        state: NDArray[np.float64],
        steps_s: NDArray[np.float64],
        start_s: NDArray[np.float64] | None = None,
    ) -> float:
        """Return half the sum of squared whitened residuals of all transitions."""
        return 0.5 * float(np.sum(self.residual(state, steps_s, start_s) ** 2))


def inverse_stack(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return inverses of a stack of matrices; not numbers where one is singular.

    The solver takes such a system for one that is not positive definite, and damps its step.
    """
    try:
        return np.asarray(np.linalg.inv(matrices))
    except np.linalg.LinAlgError:
        return np.full_like(matrices, np.nan)


def kron_stack(left: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Kronecker products of stacks of matrices, shapes (n, a, a) and (n, b, b)."""
    count, a, _ = left.shape
    b = right.shape[-1]
    product = left[:, :, None, :, None] * right[:, None, :, None, :]
    return np.asarray(product.reshape(count, a * b, a * b))
