"""A made pass of a satellite over stations, and files of other formats that report it.

All numbers are computed here from geometry, none copied from anybody's data. The satellite goes
round evenly on a circle in axes that do not turn; these coincide with the Earth's at the epoch, and
the Earth turns evenly about z. Light takes its time.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np

EPOCH = datetime(2024, 3, 20, 19, 4, tzinfo=UTC)
EARTH_RATE, LIGHT = 7.292115e-5, 299792458.0
RADIUS, RATE = 7.0e6, 1.0780e-3
STATIONS = {"Alpha": (52.1, 4.4, 20.0), "Bravo": (49.8, 9.9, 250.0), "Charlie": (53.6, 12.1, 40.0)}
_A, _E2 = 6378137.0, 6.69437999014e-3

STATION_CSV = "sensor,latitude_deg,longitude_deg,height_m\n" + "".join(
    f"{name},{lat},{lon},{height}\n" for name, (lat, lon, height) in STATIONS.items()
)


def ecef(latitude_deg, longitude_deg, height_m):
    lat, lon = np.radians([latitude_deg, longitude_deg])
    normal = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    return np.array(
        [
            (normal + height_m) * np.cos(lat) * np.cos(lon),
            (normal + height_m) * np.cos(lat) * np.sin(lon),
            (normal * (1.0 - _E2) + height_m) * np.sin(lat),
        ]
    )


def turned(vector, angle):
    """Return components on axes turned about z by an angle."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = vector
    return np.array([cos * x + sin * y, cos * y - sin * x, z])


def inertial(time_s):
    """Return where the satellite is in axes that do not turn: over the stations at 60 s."""
    above = ecef(51.0, 8.0, 0.0)
    up = above / np.linalg.norm(above)
    along = np.cross([0.3, -0.2, 1.0], up)
    along /= np.linalg.norm(along)
    angle = RATE * (time_s - 60.0)
    return RADIUS * (np.cos(angle) * up + np.sin(angle) * along)


def satellite(time_s):
    """Return where the satellite is in ECEF."""
    return turned(inertial(time_s), EARTH_RATE * time_s)


def seen(station, time_s):
    """Return azimuth and elevation, degrees, and the light time, seconds, at reception."""
    lat, lon, height = STATIONS[station]
    # On the Earth's axes as they are at reception.
    place, delay = ecef(lat, lon, height), 0.0
    for _ in range(5):
        way = turned(inertial(time_s - delay), EARTH_RATE * time_s) - place
        delay = np.linalg.norm(way) / LIGHT
    lat, lon = np.radians([lat, lon])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    north = np.cross(up, east)
    x, y, z = way @ east, way @ north, way @ up
    return np.degrees(np.arctan2(x, y)) % 360.0, np.degrees(np.arctan2(z, np.hypot(x, y))), delay


def utc(time_s, *, ordinal=False):
    moment = EPOCH + timedelta(microseconds=round(time_s * 1e6))
    return moment.strftime("%Y-%jT%H:%M:%S.%f" if ordinal else "%Y-%m-%dT%H:%M:%S.%f")


def sightings(*, step_s=2.0, last_s=118.0, sigma_deg=0.0, seed=1):
    """Return (time, station, azimuth, elevation) of all stations in turn."""
    rng = np.random.default_rng(seed)
    rows = []
    for number, name in enumerate(STATIONS):
        for time in np.arange(0.1 + 0.37 * number, last_s, step_s):
            azimuth, elevation, _ = seen(name, time)
            elevation += sigma_deg * rng.normal()
            azimuth += sigma_deg * rng.normal() / np.cos(np.radians(elevation))
            rows.append((float(time), name, azimuth % 360.0, elevation))
    return rows


def tdm(rows=None, *, system="UTC", shift_s=0.0, extra="", keywords="", ordinal=False):
    """Return a tracking data message in KVN, a segment for each station."""
    rows = sightings() if rows is None else rows
    parts = [f"CCSDS_TDM_VERS = 2.0\nCREATION_DATE = {utc(0.0)}\nORIGINATOR = MADE\n"]
    for name in dict.fromkeys(row[1] for row in rows):
        parts.append(
            f"META_START\nCOMMENT made\nTIME_SYSTEM = {system}\nPARTICIPANT_1 = {name}\n"
            "PARTICIPANT_2 = 2024-001A\nMODE = SEQUENTIAL\nPATH = 2,1\nANGLE_TYPE = AZEL\n"
            f"{keywords}META_STOP\nDATA_START\n{extra}"
        )
        for time, station, azimuth, elevation in rows:
            if station == name:
                text = utc(time + shift_s, ordinal=ordinal)
                parts.append(f"ANGLE_1 = {text} {azimuth:.9f}\nANGLE_2 = {text} {elevation:.9f}\n")
        parts.append("DATA_STOP\n")
    return "".join(parts)


def tdm_xml(rows=None):
    """Return the same in XML."""
    rows = sightings() if rows is None else rows
    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>\n<tdm id="CCSDS_TDM_VERS" version="2.0">\n'
        f"<header><CREATION_DATE>{utc(0.0)}</CREATION_DATE><ORIGINATOR>MADE</ORIGINATOR></header>\n"
        "<body>\n"
    ]
    for name in dict.fromkeys(row[1] for row in rows):
        parts.append(
            f"<segment><metadata><TIME_SYSTEM>UTC</TIME_SYSTEM><PARTICIPANT_1>{name}"
            "</PARTICIPANT_1>\n<PARTICIPANT_2>2024-001A</PARTICIPANT_2><MODE>SEQUENTIAL</MODE>"
            "<PATH>2,1</PATH>\n<ANGLE_TYPE>AZEL</ANGLE_TYPE></metadata>\n<data>\n"
        )
        for time, station, azimuth, elevation in rows:
            if station == name:
                parts.extend(
                    f"<observation><EPOCH>{utc(time)}</EPOCH><{key}>{value:.9f}</{key}>"
                    "</observation>\n"
                    for key, value in (("ANGLE_1", azimuth), ("ANGLE_2", elevation))
                )
        parts.append("</data></segment>\n")
    return "".join([*parts, "</body>\n</tdm>\n"])
