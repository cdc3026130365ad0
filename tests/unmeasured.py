"""Processes that tests interrupt, outside of coverage.

A KeyboardInterrupt inside coverage's own code, between taking its lock and letting it go, leaves
the process waiting for that lock for good.
"""

import os


def environment():
    """Return the environment of this process without what starts coverage in a new one."""
    return {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE_")}
