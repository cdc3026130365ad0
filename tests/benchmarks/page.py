"""The figures as Markdown, and into a page between two comments."""

from __future__ import annotations

from typing import TYPE_CHECKING

from contestants import CONTESTANTS
from report import OURS, Results, at_minimum, found, heading, milliseconds

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from targets import Target

FIGURES = "figures"
SCALING = "scaling"
"""Names of the parts of a page that are replaced."""

_HEADER = (
    "| | set-up, ms | solve, ms | iterations | marginals, ms | solve + marginals, ms | "
    "to ours | memory, MB | RMSE, m | |"
)


def markdown(results: Results, wanted: list[Target], around: dict[str, str]) -> str:
    """Return tables of all sizes, and the targets."""
    lines = [", ".join(f"{name} {value}" for name, value in around.items()) + ".", ""]
    for size in results:
        lines += [f"**{heading(size)}**", "", _HEADER, "| --- |" + " --- |" * 9]
        lines += list(_rows(results, size))
        lines.append("")
    lines += ["| target | measured | wanted | |", "| --- | --- | --- | --- |"]
    for target in wanted:
        beyond = "> " if target.bound else ""
        value = "not measured" if target.value is None else f"{beyond}{target.value:.3g}"
        bound = "at least" if target.at_least else "at most"
        verdict = "holds" if target.holds else "**fails**"
        lines.append(f"| {target.text} | {value} | {bound} {target.limit:g} | {verdict} |")
    return "\n".join(lines) + "\n"


def _rows(results: Results, size: str) -> Iterator[str]:
    ours = found(results, size, OURS)
    for name, entry in results[size].items():
        shown = f"**{name}**" if name == OURS else name
        if isinstance(entry, str):
            yield f"| {shown} |" + " |" * 4 + f" {entry} |" + " |" * 4
            continue
        note = ""
        if not CONTESTANTS[name].same_cost:
            note = "filter"
        elif not at_minimum(results, size, name):
            note = "not at the minimum"
        cells = (
            milliseconds(entry.set_up_s),
            milliseconds(entry.solve_s),
            str(entry.iterations),
            milliseconds(entry.marginals_s),
            milliseconds(entry.total_s),
            f"{entry.total_s / ours.total_s:.1f}" if ours else "",
            f"{entry.memory_mb:.0f}",
            f"{entry.rmse_m:.2f}",
            note,
        )
        yield f"| {shown} | " + " | ".join(cells) + " |"


def put(text: str, page: Path, part: str) -> None:
    """Replace what stands between the two comments of a page that name a part."""
    begin, end = f"<!-- {part} -->", f"<!-- end of {part} -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, ended, after = rest.partition(end)
    if not (found and ended):
        raise SystemExit(f"{page} has no lines {begin} and {end}")
    page.write_text(f"{before}{begin}\n\n{text.strip()}\n\n{end}{after}", encoding="utf-8")
