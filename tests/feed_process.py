"""``geograph track`` with the stand-in engine, as a process: python feed_process.py ARGUMENTS."""

from __future__ import annotations

import sys
import time

from stand_in_engine import StandInEngine

from geograph.cli import main, run_track


class SlowEngine(StandInEngine):
    """Takes a while for every update, so that there is a moment to kill it in."""

    def update(self, measurements):
        time.sleep(float(SECONDS))
        return super().update(measurements)


if __name__ == "__main__":
    SECONDS, *words = sys.argv[1:]
    run_track._engine = lambda recording, _: SlowEngine(recording)
    sys.exit(main(["track", *words]))
