"""Results of one smoothed recording, and the folders that hold them.

Pictures, comparisons and tables are made from :class:`Results` and nothing else, so that what can
be drawn right after smoothing can be drawn again, years later, from the files alone
(docs/results.md describes them).
"""

from geograph.results.data import (
    ErrorCurve,
    ErrorState,
    PlatformPath,
    ResidualTable,
    Results,
    SensorPath,
)
from geograph.results.extract import as_results, from_track, versions
from geograph.results.read import load
from geograph.results.write import save

__all__ = [
    "ErrorCurve",
    "ErrorState",
    "PlatformPath",
    "ResidualTable",
    "Results",
    "SensorPath",
    "as_results",
    "from_track",
    "load",
    "save",
    "versions",
]
