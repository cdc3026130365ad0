"""Results as one page: everything in one HTML file that opens without a network.

Python makes what is shown: texts, tables, and for each picture a small description of its lines and
points; the page's own script draws them, turns the view and moves the object. The page holds no
code but its own (``assets/``) and its content policy lets it load nothing.
"""

from geograph.report_page.write import read_results, write_report

__all__ = ["read_results", "write_report"]
