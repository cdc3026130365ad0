"""Pages written whole or not at all, and the results that they are of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.io.atomic import replacing_file
from geograph.report_page.page import page
from geograph.results import as_results, load
from geograph.results.names import SUMMARY

if TYPE_CHECKING:
    from geograph.results import Results
    from geograph.track import Track

MOST_RESULTS = 60
"""More results on one page are neither small nor looked at."""


def write_report(
    track: Track | Results | Sequence[Track | Results],
    path: Path | str,
    *,
    command: str | None = None,
) -> None:
    """Write one page, in one file, that shows results and opens without a network.

    Parameters
    ----------
    track
        A track or its results (:func:`geograph.results.load` reads them from a folder), or several,
        of which the page shows one at a time.
    path
        The file, by custom ``.html``; an older one is replaced. When anything fails it stays.
    command
        The command line that makes the page, to stand in it.

    Raises
    ------
    InputError
        If there is nothing to show, or too much for one page, or the file cannot be written.

    Notes
    -----
    Lines of more than 1000 points and more than 12 000 residuals are thinned, and the page says so;
    with several results on it, more.
    """
    several = list(track) if isinstance(track, Sequence) else [track]
    if not 0 < len(several) <= MOST_RESULTS:
        raise InputError(
            f"{len(several)} results for one page; expected 1 to {MOST_RESULTS}; "
            "make pages of some of them",
            path=path,
        )
    text = page([as_results(one) for one in several], command=command)
    with replacing_file(path) as draft:
        draft.write_text(text, encoding="utf-8", newline="\n")


def read_results(folder: Path | str) -> list[Results]:
    """Return the results in a folder: one, or those of many recordings in a folder each.

    Parameters
    ----------
    folder
        As ``geograph smooth`` wrote it.

    Raises
    ------
    InputError
        If it holds none, or one of them is not as it was written.
    """
    from geograph.batch import SUMMARY_TABLE

    folder = Path(folder)
    if not (folder / SUMMARY_TABLE).is_file() or (folder / SUMMARY).exists():
        return [load(folder)]
    found = sorted(entry.parent for entry in folder.glob(f"*/{SUMMARY}"))
    if not found:
        raise InputError("holds no results: none of its recordings gave any", path=folder)
    if len(found) > MOST_RESULTS:
        raise InputError(
            f"holds {len(found)} results; expected {MOST_RESULTS} at most for one page; "
            f"name one of them, {found[0]}",
            path=folder,
        )
    return [load(one) for one in found]
