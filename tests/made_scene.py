"""A random object and receivers for standalone factors, with keys for every error."""

import gtsam
import numpy as np
from differences import assert_derivative

from geograph.factors import Receiver

OBJECT, NEXT, SPEED = 0, 1, 2


class World:
    """Random receivers with keys for every error, and an object, in units of the scene."""

    def __init__(self, seed, frame, speed, order, *, between, count=4):
        rng = self.rng = np.random.default_rng(seed)
        self.frame, self.speed, self.order = frame, speed, order
        self.length = 300.0 if speed < 1e6 else 3e5
        self.pace = 20.0 if speed < 1e6 else 3e3
        centre = np.array([6.4e6, 1e6, -2e5]) if frame == "ecef" else np.zeros(3)
        time = self.length / self.pace
        powers = np.repeat([self.length, self.pace, self.pace / time][:order], 3)
        self.keys, self.vectors, self.steps = [], [], []
        where = np.concatenate([centre, np.zeros(3 * order - 3)])
        self.add(OBJECT, where + powers * rng.normal(size=3 * order), 1e-2 * powers)
        self.path = {"order": order}
        if between:
            self.add(NEXT, where + powers * rng.normal(size=3 * order), 1e-2 * powers)
            self.path |= {"next_key": NEXT, "step_s": 2.0 * time}
        self.time = 0.4 * time if between else 0.1 * time
        self.add(SPEED, 0.02 * speed * rng.normal(size=1), np.array([1e-3 * speed]))
        self.receivers = [self._receiver(i, centre, time) for i in range(count)]
        self.options = {"speed_m_s": speed, "speed_key": SPEED, "frame": frame, **self.path}

    def add(self, key, vector, steps):
        """Take up a key with its value and the steps of its differences."""
        self.keys.append(key)
        self.vectors.append(vector)
        self.steps.append(steps)

    def _receiver(self, index, centre, time):
        rng, key = self.rng, 10 * (index + 1)
        self.add(key, 0.1 * self.length * rng.normal(size=1), np.array([1e-2 * self.length]))
        self.add(key + 1, rng.normal(size=1), np.ones(1))
        blocks = 1 + index % 3
        powers = np.repeat([self.length, self.pace, self.pace / time][:blocks], 3)
        self.add(key + 2, 0.1 * powers * rng.normal(size=3 * blocks), 1e-2 * powers)
        return Receiver(
            position_m=centre + self.length * rng.normal(size=3),
            velocity_m_s=self.pace * rng.normal(size=3),
            acceleration_m_s2=self.pace / time * rng.normal(size=3),
            clock_key=key,
            frequency_key=key + 1,
            position_key=key + 2,
            position_order=blocks,
        )

    def values(self, point=None):
        values, used = gtsam.Values(), 0
        for key, vector in zip(self.keys, self.vectors, strict=True):
            part = vector if point is None else point[used : used + vector.size]
            values.insert(key, part)
            used += vector.size
        return values

    def check(self, factor, *, function=None, rtol=1e-6):
        """Compare the linearisation of a factor with differences of its error."""
        values = self.values()
        own = list(factor.keys())
        jacobian, right = factor.linearize(values).jacobian()
        value = factor.unwhitenedError(values)
        np.testing.assert_array_equal(-right, value)
        sizes = np.array([vector.size for vector in self.vectors])
        ends = np.concatenate([[0], np.cumsum(sizes)])
        matrix = np.zeros((value.size, ends[-1]))
        used = 0
        for key in own:
            place = self.keys.index(key)
            size = sizes[place]
            matrix[:, ends[place] : ends[place + 1]] = jacobian[:, used : used + size]
            used += size
        analytic = matrix if function is None else function(value)[None] @ matrix

        def error(point):
            found = factor.unwhitenedError(self.values(point))
            return found if function is None else [0.5 * found @ found]

        point, steps = np.concatenate(self.vectors), np.concatenate(self.steps)
        assert_derivative(analytic, error, point, steps, rtol=rtol)
