"""Physical constants, each with the publication that fixes its value.

All are in SI units. The Earth's are those of WGS 84 (NIMA TR8350.2, third edition, 2000) unless
another source is named.
"""

from typing import Final

SPEED_OF_LIGHT_M_S: Final = 299_792_458.0
"""Speed of light in vacuum, exact by the definition of the metre (SI, 1983)."""

EARTH_GM_M3_S2: Final = 3.986004418e14
"""Gravitational parameter of the Earth with its atmosphere (WGS 84)."""

EARTH_RADIUS_M: Final = 6_378_137.0
"""Equatorial radius of the WGS 84 ellipsoid."""

EARTH_FLATTENING: Final = 1.0 / 298.257223563
"""Flattening of the WGS 84 ellipsoid."""

EARTH_J2: Final = 1.082_626_683_553e-3
"""Unnormalised second zonal harmonic, -sqrt(5) C20 with C20 = -0.484165371736e-3 (EGM96)."""

EARTH_J3: Final = -2.532_656_485_33e-6
"""Unnormalised third zonal harmonic, -sqrt(7) C30 with C30 = 0.957254173792e-6 (EGM96)."""

EARTH_J4: Final = -1.619_621_591_367e-6
"""Unnormalised fourth zonal harmonic, -3 C40 with C40 = 0.539873863789e-6 (EGM96)."""

EARTH_ROTATION_RAD_S: Final = 7.292115e-5
"""Angular speed of the Earth about its axis (WGS 84)."""

STANDARD_GRAVITY_M_S2: Final = 9.80665
"""Standard acceleration of free fall (CGPM, 1901); used by the ballistic model in a local frame."""
