"""Entry point of ``geograph`` and ``python -m geograph``."""

import os
import sys


def main() -> None:
    """Run the command line and leave with its exit status."""
    from geograph.workers import THREAD_LIMITS

    # The matrices are small: on a busy machine, threads that wait for each other cost tenfold.
    for name in THREAD_LIMITS:
        os.environ.setdefault(name, "1")
    from geograph.cli import main as run

    sys.exit(run())


if __name__ == "__main__":
    main()
