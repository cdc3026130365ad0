"""Measurement families: every kind of measurement, written once.

A family holds the columns of one kind of measurement and evaluates all of them in one vectorised
pass: whitened residuals, and derivatives by the two knots around each measurement, by the constant
sensor states and by the walks. The batch engine, the stacked GTSAM factors, the Cramer-Rao bound
and the residual report all call the same pass.
"""

from geograph.families.arrivals import ArrivalFamily
from geograph.families.base import Evaluation, Family, Report, SensorFamily, Values
from geograph.families.bearings import BearingFamily
from geograph.families.constraints import (
    CONSTRAINT_FAMILIES,
    AltitudeFamily,
    SpeedFamily,
    TerrainFamily,
)
from geograph.families.differences import FrequencyDifferenceFamily, TimeDifferenceFamily
from geograph.families.fixes import FixFamily
from geograph.families.rays import World

__all__ = [
    "CONSTRAINT_FAMILIES",
    "AltitudeFamily",
    "ArrivalFamily",
    "BearingFamily",
    "Evaluation",
    "Family",
    "FixFamily",
    "FrequencyDifferenceFamily",
    "Report",
    "SensorFamily",
    "SpeedFamily",
    "TerrainFamily",
    "TimeDifferenceFamily",
    "Values",
    "World",
]
