"""Markdown documents: tables, parts between marks, and templates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from xmarl_bench.records.files import write_atomically


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]], n_numbers: int = 0) -> str:
    """A table, whose last n_numbers columns are aligned right."""
    rule = ["---"] * (len(header) - n_numbers) + ["--:"] * n_numbers
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (header, rule, *rows))


def with_part(text: str, name: str, part: str) -> str:
    """The text with the lines between the two marks of that name replaced."""
    begin, end = f"<!-- {name}:begin -->\n", f"<!-- {name}:end -->"
    before, rest = text.split(begin)
    return before + begin + part + end + rest.split(end)[1]


def rewrite(path: Path, change: Callable[[str], str]) -> None:
    """Write a document anew, atomically, with the same ends of lines on every system."""
    write_atomically(path, change(path.read_text(encoding="utf-8")).encode())


def from_template(path: Path, filters: dict[str, Callable[..., str]] | None = None, **values: Any) -> str:
    """The document of a Jinja template."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters |= filters or {}
    return environment.from_string(path.read_text(encoding="utf-8")).render(values)
