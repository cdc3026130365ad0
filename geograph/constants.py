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

SUN_GM_M3_S2: Final = 1.32712440041e20
"""Gravitational parameter of the Sun (JPL DE430, W. M. Folkner et al., IPN Progress Report
42-196, 2014, table 8)."""

MOON_GM_M3_S2: Final = 4.902800066e12
"""Gravitational parameter of the Moon (JPL DE430, as above)."""

# Height (km), density (kg/m^3) and scale height (km) of each.
_ATMOSPHERE = (
    *((0, 1.225, 7.249), (25, 3.899e-2, 6.349), (30, 1.774e-2, 6.682), (40, 3.972e-3, 7.554)),
    *((50, 1.057e-3, 8.382), (60, 3.206e-4, 7.714), (70, 8.770e-5, 6.549), (80, 1.905e-5, 5.799)),
    *((90, 3.396e-6, 5.382), (100, 5.297e-7, 5.877), (110, 9.661e-8, 7.263)),
    *((120, 2.438e-8, 9.473), (130, 8.484e-9, 12.636), (140, 3.845e-9, 16.149)),
    *((150, 2.070e-9, 22.523), (180, 5.464e-10, 29.740), (200, 2.789e-10, 37.105)),
    *((250, 7.248e-11, 45.546), (300, 2.418e-11, 53.628), (350, 9.518e-12, 53.298)),
    *((400, 3.725e-12, 58.515), (450, 1.585e-12, 60.828), (500, 6.967e-13, 63.822)),
    *((600, 1.454e-13, 71.835), (700, 3.614e-14, 88.667), (800, 1.170e-14, 124.64)),
    *((900, 5.245e-15, 181.05), (1000, 3.019e-15, 268.0)),
)

ATMOSPHERE_HEIGHT_M: Final = tuple(1e3 * height for height, _, _ in _ATMOSPHERE)
"""Heights of a mean atmosphere's table (D. A. Vallado, *Fundamentals of Astrodynamics and
Applications*, 4th ed., 2013, table 8-4, after J. R. Wertz, 1978: CIRA-72 and the US Standard
Atmosphere 1976)."""

ATMOSPHERE_DENSITY_KG_M3: Final = tuple(density for _, density, _ in _ATMOSPHERE)
"""Densities at these heights."""

ATMOSPHERE_SCALE_M: Final = tuple(1e3 * scale for _, _, scale in _ATMOSPHERE)
"""Scale heights from each of these heights to the next."""
