"""Directions against the stars: aberration by the Earth's motion, and starlight bent by the Sun.

A direction that was measured against the stars beside the object shares their aberration, and
catalogue places are free of it: reduced (astrometric, ICRS), it is the direction of the object's
light in axes that rest with the Sun's system. Paths are estimated in axes that move with the Earth
and do not turn. The same light comes, in the one and in the other, from (A. Einstein, *Zur
Elektrodynamik bewegter Körper*, Annalen der Physik 17, 1905, section 7)

    m = l / g - b (|l| - (l . b) / (1 + 1/g)),      g = 1 / sqrt(1 - b . b)

with l the line of sight in the Earth's axes, m that in the Sun's, and b the velocity of the Earth
over that of light. In the light time the Earth moves on by b |l|: the annual aberration, an angle
of up to 20.5 arcseconds whatever the distance.

The light of the stars passes the Sun and is bent away from it, that of an object near the Earth is
not. So catalogue places of stars seen beside it are nearer to the Sun than it is, by (S. A.
Klioner, *A practical relativistic model for microarcsecond astrometry in space*, AJ 125, 2003,
section 5)

    a = m - s (|m| e - (m . e) m / |m|) / (1 + m . e / |m|),      s = 2 G M / (c^2 R)

with e the unit vector from the Sun to the Earth and R their distance: 4 milliarcseconds at right
angles to the Sun.

The observer's own motion about the Earth's centre does not enter: object and stars share its
aberration, and the line of sight is from the observer at reception to the object at emission.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Nearer to the Sun than 1.4 mrad its bending grows no further: there is no star to be seen.
_NEAR_SUN = 1e-6


def astrometric_sight(
    line_of_sight_m: NDArray[np.float64],
    earth_velocity: NDArray[np.float64],
    sun_to_earth: NDArray[np.float64],
    bending: NDArray[np.float64],
    *,
    jacobian: bool = False,
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Return a vector along the astrometric direction, shape (n, 3), metres.

    Parameters
    ----------
    line_of_sight_m
        Shape (n, 3): from the observer at reception to the object at emission, in axes that move
        with the Earth's centre and do not turn, parallel to those of the ICRS.
    earth_velocity
        Shape (n, 3): b, the Earth's barycentric velocity over that of light.
    sun_to_earth
        Shape (n, 3): e, unit vectors.
    bending
        Shape (n,): s.
    jacobian
        Whether the derivative by the line of sight, shape (n, 3, 3), is returned too.
    """
    b, e = earth_velocity, sun_to_earth
    inverse = np.sqrt(1.0 - np.einsum("ni,ni->n", b, b))
    share = 1.0 / (1.0 + inverse)
    length = np.linalg.norm(line_of_sight_m, axis=1)
    along = np.einsum("ni,ni->n", line_of_sight_m, b)
    m = inverse[:, None] * line_of_sight_m - b * (length - share * along)[:, None]
    q = np.linalg.norm(m, axis=1)
    unit = m / q[:, None]
    cosine = np.einsum("ni,ni->n", unit, e)
    closeness = 1.0 + cosine
    far = closeness > _NEAR_SUN
    divided = bending / np.maximum(closeness, _NEAR_SUN)
    turned = q[:, None] * e - cosine[:, None] * m
    value = m - divided[:, None] * turned
    if not jacobian:
        return value, None
    eye = np.eye(3)
    by_sight = (
        inverse[:, None, None] * eye
        - b[:, :, None] * (line_of_sight_m / length[:, None] - share[:, None] * b)[:, None, :]
    )
    # cosine changes by (e - cosine unit) . dm / q, and q by unit . dm.
    change = (e - cosine[:, None] * unit) / q[:, None]
    by_m = eye - divided[:, None, None] * (
        e[:, :, None] * unit[:, None, :]
        - m[:, :, None] * change[:, None, :]
        - cosine[:, None, None] * eye
    )
    grown = np.where(far, divided / np.maximum(closeness, _NEAR_SUN), 0.0)
    by_m += (grown[:, None] * turned)[:, :, None] * change[:, None, :]
    return value, np.asarray(by_m @ by_sight)
