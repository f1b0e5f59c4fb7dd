"""A metric is declared once, in its row; everything else derives from it."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import xmarl_bench
from xmarl_bench.entry.metric_records import EpisodeRow, ExplanationRow, Metrics
from xmarl_bench.entry.protocol import DEFINITIONS
from xmarl_bench.entry.schema import PolicyRecord
from xmarl_bench.metrics.table import GAINS, METRICS, ORDER, SUCCESS, Direction, Group, by_name, names_of
from xmarl_bench.scoring.rankings import number

HARNESS = Path(str(xmarl_bench.__file__)).parent
ROOT = HARNESS.parent
# Files that may name metrics, and why.
NAMING = {
    "metrics/table.py": "the table",
    "metrics/__init__.py": "exports functions of the same names",
    "scoring/states.py": "computes those of a mask and of a policy",
    "scoring/behaviour.py": "computes those of behaviour",
    "scoring/measure.py": "computes those of sanity",
    "scoring/not_measured.py": "which fields of an episode a task's infos leave out",
    "checks/task_checks.py": "which fields of an episode a task's infos fill",
    "checks/policy_checks.py": "compares rewards where a task has no success",
    "scoring/results.py": "keeps the fields of an episode",
    "meta/curves.py": "tests certain metrics on degraded rankings",
    "meta/degenerate.py": "tests certain metrics on degenerate explanations",
    "policy/default_policies.py": "ranks policies by what they can do",
    "submission/consistency.py": "which metrics follow from which",
    "submission/control_consistency.py": "which metrics of a control follow from its mask",
    "board/columns.py": "draws the metric that can be gamed, and the agreement of metrics",
    "board/assets/scores.js": "what the page shows first, and of a policy",
}
PAPER = "papers/kailas2025/"  # its statements are about certain metrics
# Fields of a policy with the name of a metric.
NAMES = set(names_of(*Group)) - set(PolicyRecord.model_fields)

ADD_A_METRIC = """
import json, runpy
from xmarl_bench.metrics import table
made = table.Metric(
    "made_up", "made-up thing", "what nobody measured", "a sentence of the protocol", table.Group.EXPLANATION,
    table.SHARE, table.Direction.LOWER, column=3, short="made",
)
table.METRICS = (made, *table.METRICS)
from xmarl_bench.board.columns import COLUMNS
from xmarl_bench.cli.score_table import SCORE_COLUMNS
from xmarl_bench.compare.comparison import BETTER
from xmarl_bench.entry.protocol import DEFINITIONS
from xmarl_bench.entry.schema import Entry
from xmarl_bench.papers.kailas2025.claims import ORIENTATION
from xmarl_bench.papers.kailas2025.tables import METRIC_NAMES
schemas = Entry.model_json_schema()["$defs"]
page = runpy.run_path("docs/make_metric_tables.py")
print(json.dumps({
    "row": schemas["EpisodeRowColumns"]["properties"]["made_up"]["anyOf"][0]["items"]["anyOf"][0],
    "means": [name for name, schema in schemas.items() if "made_up" in schema.get("required", ())],
    "column": COLUMNS["made_up"],
    "terminal": SCORE_COLUMNS["made"],
    "better": BETTER["made_up"],
    "study": [ORIENTATION["made_up"], METRIC_NAMES["made_up"]],
    "definition": DEFINITIONS["made_up"],
    "docs": [line for line in page["page"](page["PAGE"].read_text()).splitlines() if "made_up" in line],
}))
"""


@pytest.mark.slow
@pytest.mark.usefixtures("needs_torch")
def test_a_new_metric_needs_only_a_row() -> None:
    """In its own process, because the models are created on import."""
    ran = subprocess.run([sys.executable, "-c", ADD_A_METRIC], cwd=ROOT, capture_output=True, check=True)
    assert json.loads(ran.stdout) == {
        "row": {"maximum": 1.000001, "minimum": -1e-06, "type": "number"},
        "means": ["ControlMetrics", "EpisodeRowColumns", "Metrics"],
        "column": "made-up thing \u2193",
        "terminal": "made_up",
        "better": "lower",
        "study": [-1, "made-up thing"],
        "definition": "a sentence of the protocol",
        "docs": ["| `made_up` | made-up thing | what nobody measured | [0, 1] |  | low |  |"],
    }


@pytest.mark.parametrize("ending", ["py", "js", "jinja"])
def test_no_other_file_names_a_metric(ending: str) -> None:
    files = [path for path in HARNESS.rglob(f"*.{ending}") if "plugins/templates" not in path.as_posix()]
    naming = {path.relative_to(HARNESS).as_posix() for path in files if named_in(path)}
    allowed = {name for name in NAMING if name.endswith(ending)}
    assert {name for name in naming if not name.startswith(PAPER)} == allowed


def named_in(path: Path) -> set[str]:
    """Metrics named in a file: in strings for Python, anywhere for other files."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return NAMES & set(re.findall(r"\w+", text))
    constants = [node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant)]
    return NAMES & {value for value in constants if isinstance(value, str)}


def test_names_and_headings_are_unique() -> None:
    assert len(by_name()) == len(METRICS)
    for heading in ("title", "column_heading", "short"):
        headings = [value for metric in METRICS if (value := getattr(metric, heading)) is not None]
        assert len(set(headings)) == len(headings), heading
    assert {ORDER, SUCCESS, *GAINS, *GAINS.values()} <= set(by_name())


def test_models_have_the_metrics_of_the_table_and_definitions_are_complete() -> None:
    assert set(Metrics.model_fields) == set(names_of(*Group)) == set(by_name())
    assert set(Metrics.model_fields) <= set(EpisodeRow.model_fields)
    assert tuple(ExplanationRow.model_fields) == names_of(Group.EXPLANATION)
    for metric in METRICS:
        assert metric.name in DEFINITIONS or f"{metric.name.split('_')[0]}_*" in DEFINITIONS, metric.name


def test_a_value_outside_its_range_is_refused() -> None:
    inside = {
        metric.name: 0.5 * ((metric.range.low or 0.0) + (metric.range.high or 0.0))
        for metric in METRICS
        if metric.group is Group.EXPLANATION
    }
    assert ExplanationRow.model_validate(inside).mask_mass == number(0.5)
    for metric in METRICS:
        if metric.name not in inside:
            continue
        low, high = metric.range.low, metric.range.high
        low = metric.range.least if low is None else low
        for edge, step in ((low, -1e-3), (high, 1e-3)):
            if edge is not None:
                ExplanationRow.model_validate({**inside, metric.name: float(edge)})
                with pytest.raises(ValueError, match=metric.name):
                    ExplanationRow.model_validate({**inside, metric.name: edge + step})


def test_a_variant_has_the_direction_of_its_metric() -> None:
    for name, metric in by_name().items():
        base = by_name().get(re.sub("^comm_", "", name))
        assert base is None or (base.direction, base.range) == (metric.direction, metric.range), name
    assert by_name()[ORDER].direction is Direction.HIGHER
