"""docs/performance.md is made of docs/performance.json and of the docstrings of benchmarks."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    return runpy.run_path(str(DOCS / "make_performance.py"))


def test_it_is_that_of_the_data(made: dict[str, Any]) -> None:
    """If this fails, run docs/make_performance.py."""
    data = json.loads((DOCS / "performance.json").read_bytes())
    assert made["page"](data) == (DOCS / "performance.md").read_text(encoding="utf-8")


def comparison(ratio: float, low: float, high: float) -> dict[str, Any]:
    values = {"ours": 2.0, "theirs": 2.0 * ratio, "ratio": ratio, "low": low, "high": high, "bar": None}
    return {"what": f"ours {ratio}", "peer": "another", "unit": "ms", "remark": "", **values}


def results(file: str, *comparisons: dict[str, Any], **figures: Any) -> dict[str, Any]:
    """As pytest-benchmark writes them."""
    benchmark = {
        "fullname": f"tests/benchmarks/{file}::test_it[3]",
        "extra_info": {"comparisons": list(comparisons), **figures},
        "options": {"timer": "process_time"},
        "stats": {"min": 0.123456, "median": 0.2, "max": 1234.5, "rounds": 7},
    }
    return {
        "benchmarks": [benchmark],
        "machine_info": {"cpu": {"brand_raw": "A processor", "count": 2}},
        "commit_info": {"id": "0123456789abcdef", "dirty": True},
        "datetime": "2026-01-02T03:04:05",
    }


def test_ranges_decide_what_is_ahead(made: dict[str, Any]) -> None:
    rows = comparison(0.5, 0.4, 0.9), comparison(1.2, 0.9, 1.5), comparison(2.0, 1.1, 3.0)
    page = made["page"](made["condensed"]([results("test_speed.py", *rows)], {}))
    parts = {part.split("\n", 1)[0]: part for part in page.split("\n## ")}
    for title, ratio in (("Behind", 0.5), ("Level", 1.2), ("Ahead", 2.0)):
        assert [line.split(" | ")[0] for line in parts[title].splitlines()[4:] if line] == [f"| ours {ratio}"]
    assert "0.500 (0.400 to 0.900)" in parts["Behind"]


def test_a_section_says_where_it_ran_and_what_has_no_peer(made: dict[str, Any]) -> None:
    page = made["page"](made["condensed"]([results("test_step_cost.py", us_per_step=3.14159)], {}))
    assert "commit 0123456789ab+, A processor, 2 cores." in page
    assert "| `it[3]` | 0.123 / 0.200 / 1,230 CPU s | 7 | us per step 3.14 |" in page


def test_new_results_replace_those_of_the_same_file_only(made: dict[str, Any]) -> None:
    known = {"test_speed.py": {"cpu": "old"}, "test_step_cost.py": {"cpu": "old"}}
    data = made["condensed"]([results("test_speed.py"), results("test_speed.py")], known)
    assert data["test_speed.py"]["cpu"] == "A processor, 2 cores"
    assert len(data["test_speed.py"]["benchmarks"]) == 2  # of both runs
    assert data["test_step_cost.py"] == {"cpu": "old"}
