"""The hot loops in C, where they were compiled; the NumPy code beside each call is the reference.

``compiled`` is the module, or None where no compiler was there when geograph was installed, or
where the environment variable ``GEOGRAPH_KERNELS`` is ``numpy``. Whoever calls it holds the NumPy
code that it stands in for, and both give the same numbers to rounding (tests/test_kernels.py).
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from geograph import states

if TYPE_CHECKING:
    from types import ModuleType

_CHANNELS = (
    *("AZIMUTH", "ELEVATION", "CLOCK", "POSITION", "VELOCITY", "FREQUENCY", "SPEED"),
    "CHANNELS",
)


def _load() -> ModuleType | None:
    """Return the compiled module if it may be used, and means the same channels of error."""
    if os.environ.get("GEOGRAPH_KERNELS", "") == "numpy":
        return None
    try:
        from geograph.kernels import _compiled
    except ImportError:
        return None
    # An old build beside new sources would read the wrong columns.
    same = all(getattr(_compiled, name, None) == getattr(states, name) for name in _CHANNELS)
    return _compiled if same else None


compiled: Any = _load()
"""The compiled module, or None."""

# An array of this size is made and let go, untouched: the C library of Linux then keeps the pages
# of smaller arrays for the next ones (its mmap threshold is dynamic, mallopt(3)), where it would
# give them back and have each zeroed again. A third of a linearisation was spent there.
_KEPT_BYTES = 31 * 2**20
np.empty(_KEPT_BYTES, dtype=np.uint8)


def indices(array: Any) -> Any:
    """Return indices as the compiled code takes them: C-contiguous, int64."""
    return np.ascontiguousarray(array, dtype=np.int64)


def flat(array: Any) -> Any:
    """Return an array as the compiled code takes it: C-contiguous, float64; None stays None."""
    return None if array is None else np.ascontiguousarray(array, dtype=np.float64)
