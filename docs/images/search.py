"""Draw the pictures of docs/search.md: python docs/images/search.py (from the top folder)."""

import contextlib
import io
import os
import re
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
here = Path(__file__).parent.resolve()
text = (here.parent / "search.md").read_text(encoding="utf-8")
names: dict = {}
with tempfile.TemporaryDirectory() as folder:
    os.chdir(folder)
    with contextlib.redirect_stdout(io.StringIO()):
        for block in re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)[:-2]:
            exec(block, names)
    import geograph as gg
    from geograph.plot import likelihood
    from geograph.plot._bound import map_figure

    recording = gg.read("search")
    over = gg.bound_map(recording, center_m=[2200.0, 2200.0, 0.0], extent_m=8000.0, cells=45)
    map_figure(over).savefig(here / "search_map.png", dpi=90)
    import numpy as np

    few = np.flatnonzero(recording.bearings.time_s < 2.0)
    columns = {name: column[few] for name, column in vars(recording.bearings).items()}
    first = gg.smooth(replace(recording, bearings=gg.Bearings(**columns)), raise_on_failure=False)
    likelihood(first, first.likelihood_map(cells=101)).savefig(
        here / "search_posterior.png", dpi=90
    )
