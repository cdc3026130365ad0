"""One BLAS thread for many small matrices.

Knots have ten to thirty unknowns: BLAS threads cost more than they give there (measured: two
threads on two cores double the processor time of a pass, and passes in several processes hold each
other up). Processes are the way to use more cores (``geograph smooth --jobs``).
"""

from __future__ import annotations

from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from threadpoolctl import ThreadpoolController

if TYPE_CHECKING:
    from collections.abc import Iterator

_depth = 0


@cache
def _controller() -> ThreadpoolController:
    # Finding the loaded libraries takes milliseconds, so it is done once.
    return ThreadpoolController().select(user_api="blas")


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Hold BLAS to one thread within the context; nested contexts cost nothing."""
    global _depth  # noqa: PLW0603 - BLAS threads are a property of the process, too
    _depth += 1
    try:
        # Asking is cheaper than setting, by more than a small update takes to notice.
        if _depth > 1 or all(held.get_num_threads() == 1 for held in _controller().lib_controllers):
            yield
        else:
            with _controller().limit(limits=1):
                yield
    finally:
        _depth -= 1
