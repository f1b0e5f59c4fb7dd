"""Writes docs/performance.md from docs/performance.json, which holds what the benchmarks measured.

    make bench                                       # everything, best on an idle machine
    .venv/bin/python -m pytest --benchmark-only --benchmark-json=FILE tests/benchmarks/test_speed.py
    .venv/bin/python docs/make_performance.py FILE   # in place of earlier results of these benchmark files
    .venv/bin/python docs/make_performance.py        # after an edit of a benchmark's docstring

tests/docs/test_performance_page.py fails until the page is that of the data and of the docstrings.
"""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path
from typing import Any

from xmarl_bench.records.files import write_atomically, write_json
from xmarl_bench.records.markdown import markdown_table

HERE = Path(__file__).parent
ROOT = HERE.parent
DATA, PAGE = HERE / "performance.json", HERE / "performance.md"
BENCHMARKS = ROOT / "tests" / "benchmarks"
Record = dict[str, Any]

INTRODUCTION = """# Performance

How fast this project is beside what others would use in its place, and what its own parts cost.

`make bench` measures everything and writes this page (`docs/make_performance.py`). Both
sides of a comparison run in turns, on one thread, in CPU time, so that other load on the machine slows both.
*Times as fast* is the median over rounds with its range: above 1 ours is ahead. A *bar* is the ratio below
which `make bench` fails.
"""


def condensed(runs: list[Record], known: Record) -> Record:
    """`known`, with the results of runs of pytest-benchmark in place of those of the same benchmark files."""
    found: Record = {}
    for results in runs:
        machine, commit = results["machine_info"]["cpu"], results["commit_info"]
        run = {
            "date": results["datetime"][:10],
            "commit": commit["id"][:12] + ("+" if commit["dirty"] else ""),
            "cpu": f"{machine['brand_raw']}, {machine['count']} cores",
        }
        for each in results["benchmarks"]:
            file = Path(each["fullname"].partition("::")[0]).name
            found.setdefault(file, {**run, "benchmarks": []})["benchmarks"].append(_row(each))
    return {**known, **found}


def _row(result: Record) -> Record:
    """One benchmark: its seconds, its comparisons and all other figures that it kept."""
    figures = _short(result["extra_info"])
    return {
        "name": result["fullname"].partition("::")[2].removeprefix("test_"),
        "rounds": result["stats"]["rounds"],
        "timer": "s" if result["options"]["timer"] == "perf_counter" else "CPU s",
        "seconds": [_short(result["stats"][key]) for key in ("min", "median", "max")],
        "comparisons": figures.pop("comparisons", []),
        "figures": figures,
    }


def page(data: Record) -> str:
    """The whole document."""
    rows = [row for run in data.values() for each in run["benchmarks"] for row in each["comparisons"]]
    behind = [row for row in rows if row["high"] < 1]
    ahead = [row for row in rows if row["low"] > 1]
    level = [row for row in rows if row not in behind and row not in ahead]
    parts = [INTRODUCTION]
    for title, some in (("Behind", behind), ("Level", level), ("Ahead", ahead)):
        if some:
            parts.append(f"## {title}\n\n{_comparisons(some)}")
    parts.append("## How it was measured, and what parts cost\n")
    for file in sorted(data):
        parts.append(_section(file, data[file]))
    return "\n".join(parts)


def _comparisons(rows: list[Record]) -> str:
    lines = []
    for row in sorted(rows, key=lambda row: float(row["ratio"])):
        peer = row["peer"] + (f" ({row['remark']})" if row["remark"] else "")
        bar = "" if row["bar"] is None else f"{row['bar']:g}"
        times = f"{_number(row['ratio'])} ({_number(row['low'])} to {_number(row['high'])})"
        values = _number(row["ours"]), _number(row["theirs"])
        lines.append((row["what"], peer, row["unit"], *values, times, bar))
    return markdown_table(("ours", "beside", "unit", "ours", "theirs", "times as fast", "bar"), lines)


def _section(file: str, run: Record) -> str:
    """The docstring of a benchmark file, where and when it ran, and the figures that have no peer."""
    title = (
        file.removeprefix("test_").removesuffix(".py").removesuffix("_speed").replace("_", " ").capitalize()
    )
    text = ast.get_docstring(ast.parse((BENCHMARKS / file).read_text(encoding="utf-8"))) or ""
    command = f"python -m pytest --benchmark-only tests/benchmarks/{file}"
    lines = [
        f"### {title}\n\n{text}\n",
        f"`{command}`, {run['date']}, commit {run['commit']}, {run['cpu']}.\n",
    ]
    alone = [each for each in run["benchmarks"] if not each["comparisons"] or each["figures"]]
    if alone:
        rows = [
            (f"`{each['name']}`", f"{' / '.join(map(_number, each['seconds']))} {each['timer']}",
             str(each["rounds"]), _value(each["figures"]))
            for each in alone
        ]  # fmt: skip
        header = "benchmark", "seconds, least / median / most", "rounds", "figures"
        lines.append(markdown_table(header, rows))
    return "\n".join(lines)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        each = (f"{key.replace('_', ' ')} {_value(inner)}" for key, inner in value.items())
        return (", " if not any(isinstance(inner, dict) for inner in value.values()) else "; ").join(each)
    if isinstance(value, list):
        return " / ".join(map(_value, value))
    return _number(value) if isinstance(value, float | int) and not isinstance(value, bool) else str(value)


def _number(value: float) -> str:
    """Three digits."""
    if abs(value) >= 100:
        return f"{float(f'{value:.3g}'):,.0f}"
    return f"{value:#.3g}".rstrip(".")


def _short(value: Any) -> Any:
    """The same with four digits in each number."""
    if isinstance(value, dict):
        return {key: _short(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_short(each) for each in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def main() -> None:
    files = {path.name for path in BENCHMARKS.glob("test_*.py")}
    known = json.loads(DATA.read_bytes()) if DATA.exists() else {}
    data = condensed([json.loads(Path(name).read_bytes()) for name in sys.argv[1:]], known)
    data = {file: run for file, run in sorted(data.items()) if file in files}
    write_json(DATA, data)
    write_atomically(PAGE, page(data).encode())
    if files - data.keys():
        print("not measured: " + ", ".join(sorted(files - data.keys())))


if __name__ == "__main__":
    main()
