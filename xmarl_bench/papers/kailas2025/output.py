"""Writes a study into a folder: results.json, tables/, figures/ and one page, report.html."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from xmarl_bench.papers.kailas2025.figures import Figure, figures_of
from xmarl_bench.papers.kailas2025.results import StudyData, results_of
from xmarl_bench.papers.kailas2025.tables import Table, decisive, difference, p_value, tables_of
from xmarl_bench.records.files import write_atomically, write_json

TEMPLATE = Path(__file__).with_name("report.html.jinja")


def write_study(folder: Path, data: StudyData, *, figures: bool = True) -> dict[str, Any]:
    """Write everything derived from the entries. The page comes last, so that its files exist."""
    results = results_of(data)
    write_json(folder / "results.json", results)
    tables = tables_of(results)
    for table in tables:
        write_atomically(folder / "tables" / f"{table.name}.md", table.markdown().encode())
        write_atomically(folder / "tables" / f"{table.name}.tex", table.latex().encode())
    drawn = list(figures_of(data)) if figures else []
    for figure in drawn:
        write_atomically(folder / "figures" / f"{figure.name}.svg", figure.svg.encode())
        write_atomically(folder / "figures" / f"{figure.name}.pdf", figure.pdf)
    write_atomically(folder / "report.html", render(results, tables, drawn).encode())
    return results


def render(results: dict[str, Any], tables: Sequence[Table], figures: Sequence[Figure]) -> str:
    """The page, which loads no other files."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals.update(decisive=decisive, difference=difference, p_value=p_value)
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    return template.render(
        results=results,
        tables={table.name: table for table in tables if table.name not in ("ledger", "beyond")},
        figures=figures,
    )
