"""Live feeds: measurements as JSON lines in, estimates as JSON lines out (docs/live.md).

>>> import geograph.feed
>>> geograph.feed.json_lines
<function json_lines at ...>
"""

from geograph.feed.assemble import Assembler
from geograph.feed.journal import Journal
from geograph.feed.replay import json_lines
from geograph.feed.rows import Line, Row, RowParser
from geograph.feed.session import Session

__all__ = ["Assembler", "Journal", "Line", "Row", "RowParser", "Session", "json_lines"]
