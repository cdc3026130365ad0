"""Measurement families: every kind of measurement, written once.

A family holds the columns of one kind of measurement and evaluates all of them in one vectorised
pass: whitened residuals, and derivatives by the two knots around each measurement, by the constant
sensor states and by the walks. The batch engine, the stacked GTSAM factors, the Cramer-Rao bound
and the residual report all call the same pass.
"""

from geograph.families.base import Evaluation, Family, Values
from geograph.families.bearings import BearingFamily
from geograph.families.constraints import AltitudeFamily, SpeedFamily

__all__ = [
    "AltitudeFamily",
    "BearingFamily",
    "Evaluation",
    "Family",
    "SpeedFamily",
    "Values",
]
