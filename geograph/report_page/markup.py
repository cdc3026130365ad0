"""Markup around texts, tables and data: whatever comes from a recording is escaped here."""

from __future__ import annotations

import html
import json
import math
from typing import TYPE_CHECKING, Any

from geograph.results.data import SURPRISING_SIGMAS
from geograph.results.write import plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geograph.report_page.facts import Sheet

_BAR_SIGMAS = 6.0


def escaped(value: object) -> str:
    """Return a text as it may stand in markup, between tags and in quoted attributes."""
    return html.escape(str(value), quote=True)


def script_data(value: Any) -> str:
    """Return data as JSON that no markup can end; what is not finite becomes null."""
    text = json.dumps(plain(value), allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def section(title: str, *parts: str) -> str:
    """Return a part of the page under a title; the parts are markup."""
    return f"<section><h2>{escaped(title)}</h2>{''.join(parts)}</section>\n"


def sentence_list(found: Sequence[str]) -> str:
    """Return a list of sentences."""
    return f'<ul class="sentences">{"".join(f"<li>{escaped(one)}</li>" for one in found)}</ul>'


def left_out_note(count: int, what: str, file: str) -> str:
    """Return a note of what is not shown and where it is; nothing if all is shown."""
    return f'<p class="note">... {count} more {what} in {escaped(file)}.</p>' if count > 0 else ""


def table(sheet: Sheet, file: str = "", *, wide: bool = False) -> str:
    """Return a table; ``file`` has the rows that are left out; a wide one scrolls on a phone."""
    numbers = [name.endswith(">") for name in sheet.head]
    heads = [
        f"<th{' class=number' if right else ''}>{escaped(name.removesuffix('>'))}</th>"
        for name, right in zip(sheet.head, numbers, strict=True)
    ]
    if sheet.bars:
        heads.insert(2, "<th></th>")
    rows = []
    for index, row in enumerate(sheet.rows):
        cells = [
            f"<td{' class=number' if right else ''}>{escaped(cell)}</td>"
            for cell, right in zip(row, numbers, strict=True)
        ]
        if sheet.bars:
            # Third, where a phone shows it too.
            cells.insert(2, f'<td class="bar">{_bar(*sheet.bars[index])}</td>')
        mark = ' class="surprising"' if index in sheet.marked else ""
        rows.append(f"<tr{mark}>{''.join(cells)}</tr>")
    kind = " class=wide" if wide else ""
    return (
        f'<div class="scroll"><table{kind}><thead><tr>{"".join(heads)}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>{left_out_note(sheet.left_out, 'rows', file)}"
    )


def _bar(value: float, half: float) -> str:
    """Return a bar of an estimate and its interval in prior sigmas, from -6 to 6."""
    if not (math.isfinite(value) and math.isfinite(half)):
        return ""

    def at(sigmas: float) -> float:
        return 100.0 * (0.5 + 0.48 * max(-_BAR_SIGMAS, min(_BAR_SIGMAS, sigmas)) / _BAR_SIGMAS)

    colour = "#b34700" if abs(value) > SURPRISING_SIGMAS else "#0072b2"
    low, high, middle = at(value - half), at(value + half), at(value)
    ticks = "".join(
        f'<line x1="{at(edge):.2f}%" x2="{at(edge):.2f}%" y1="2" y2="16" stroke="#999" '
        'stroke-dasharray="2 2"/>'
        for edge in (-SURPRISING_SIGMAS, SURPRISING_SIGMAS)
    )
    if abs(value) > _BAR_SIGMAS:
        anchor, arrow = ("end", "▶") if value > 0.0 else ("start", "◀")
        mark = f'<text x="{middle:.2f}%" y="13" text-anchor="{anchor}">{arrow}</text>'
    else:
        mark = (
            f'<circle cx="{middle:.2f}%" cy="9" r="3.2"/><line x1="{low:.2f}%" x2="{high:.2f}%" '
            f'y1="9" y2="9" stroke="{colour}" stroke-width="2"/>'
        )
    return (
        f'<svg aria-hidden="true"><rect x="{at(-1.0):.2f}%" width="{at(1.0) - at(-1.0):.2f}%" '
        f'y="1" height="16" fill="#e3e3e3"/>{ticks}'
        '<line x1="50%" x2="50%" y1="1" y2="17" stroke="#bbb"/>'
        f'<g fill="{colour}">{mark}</g></svg>'
    )
