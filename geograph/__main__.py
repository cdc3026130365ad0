"""Entry point of ``geograph`` and ``python -m geograph``."""

import sys


def main() -> None:
    """Run the command line and leave with its exit status."""
    from geograph.cli import main as run

    sys.exit(run())


if __name__ == "__main__":
    main()
