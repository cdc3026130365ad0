"""How much the tests try: what continuous integration has time for, or all.

``GEOGRAPH_THOROUGH=1 make test`` draws the many examples that the costliest properties were found
true for; without it they draw fewer, enough that a rule that breaks in one case of twenty is seen.
"""

from __future__ import annotations

import os

THOROUGH = os.environ.get("GEOGRAPH_THOROUGH", "") not in ("", "0")


def examples(few: int, many: int) -> int:
    """Return the number of examples of a property."""
    return many if THOROUGH else few
