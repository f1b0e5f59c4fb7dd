"""Fits tables into the width of the terminal. Every table of every command is printed here.

Numbers are never cut. In a narrow terminal text wraps between words, then the last columns are left out, and
a line below names them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Any, Literal

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

Row = Mapping[str, Any]
TEXT, WORD = 20, 40  # columns of a terminal that text gets at least, and up to which no word is broken
WITHOUT_TERMINAL = 160
_NUMBERS = re.compile(r"(?:NaN|[-+\d.,()%/e\s])*")


def console() -> Console:
    """The console; wide without a terminal, so that logs do not break lines."""
    terminal = Console()
    return terminal if terminal.is_terminal else Console(width=WITHOUT_TERMINAL)


def cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) and abs(value) < 1000 else str(value)


def print_table(
    rows: Sequence[Row],
    *,
    title: str | None = None,
    keep: Sequence[str] = (),
    styles: Mapping[str, str] | None = None,
) -> None:
    """One table, as print_tables."""
    print_tables([(title, rows)], keep=keep, styles=styles)


def print_tables(
    tables: Sequence[tuple[str | None, Sequence[Row]]],
    *,
    keep: Sequence[str] = (),
    styles: Mapping[str, str] | None = None,
) -> None:
    """Print tables that have the same columns, each under its title, if it has one.

    The first column always stays; of the others, those in `keep` are left out last. `styles` are rich's, by
    the text of a cell.
    """
    terminal = console()
    rows = [row for _, each in tables for row in each]
    if not rows:
        print("none")
        return
    columns = {heading: [cell(row[heading]) for row in rows] for heading in rows[0]}
    widths = fit(columns, terminal.width, keep)
    for title, each in tables:
        shown = Table()
        for heading, width in widths.items():
            justify: Literal["left", "right"] = "right" if _numeric(columns[heading]) else "left"
            shown.add_column(Text(_shown(heading)), width=width, overflow="fold", justify=justify)
        for row in each:
            cells = (cell(row[heading]) for heading in widths)
            shown.add_row(*(Text(text, (styles or {}).get(text, "")) for text in cells))
        if title is not None:
            terminal.print(Text(title, "italic"))
        terminal.print(shown, width=max(terminal.width, _total(widths.values())), crop=False)
    left_out = [_shown(heading) for heading in columns if heading not in widths]
    if left_out:
        terminal.print(Text(f"A wider terminal also shows: {', '.join(left_out)}."))


def fit(columns: Mapping[str, Sequence[str]], width: int, keep: Sequence[str] = ()) -> dict[str, int]:
    """The columns that fit into a terminal of `width`, in their order, with the width of each.

    `columns` maps a heading to its cells. The first two, by `keep` and order, stay in any width: the first is
    then folded.
    """
    least = {heading: _least(heading, cells) for heading, cells in columns.items()}
    first = next(iter(columns))
    chosen: list[str] = []
    for heading in dict.fromkeys([first, *(each for each in keep if each in columns), *columns]):
        if len(chosen) >= 2 and _total(least[each] for each in (*chosen, heading)) > width:
            break
        chosen.append(heading)
    widths = {heading: least[heading] for heading in columns if heading in chosen}
    left = width - _total(widths.values())
    if left < 0:
        widths[first] = max(widths[first] + left, 1)
    for heading in widths:
        more = max(0, min(left, _widest([_shown(heading), *columns[heading]]) - widths[heading]))
        widths[heading] += more
        left -= more
    return widths


def _least(heading: str, cells: Sequence[str]) -> int:
    """Below this width numbers would be cut, or text would be hard to read."""
    of_heading = _widest(_shown(heading).split())
    if _numeric(cells):
        return max(of_heading, _widest(cells))
    words = min(WORD, _widest(chain.from_iterable(map(str.split, cells))))
    return max(of_heading, words, min(TEXT, _widest(cells)))


def _numeric(cells: Sequence[str]) -> bool:
    return all(map(_NUMBERS.fullmatch, cells))


def _shown(heading: str) -> str:
    return heading.replace("_", " ")


def _widest(texts: Iterable[str]) -> int:
    return max(map(cell_len, texts), default=0)


def _total(widths: Iterable[int]) -> int:
    """Of a table, with its lines and spaces."""
    return 1 + sum(width + 3 for width in widths)
