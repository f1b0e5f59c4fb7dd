"""Code and commands of docs/explainers.md run unchanged."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from tests.conftest import RunCli
from tests.helpers.shipped import shipped_explainers
from xmarl_bench.explain.adapters import DECLARATIONS
from xmarl_bench.explain.explainer import Explainer

PAGE = (Path(__file__).parents[2] / "docs" / "explainers.md").read_text(encoding="utf-8")
BLOCKS: list[str] = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.slow
def test_the_code_runs_from_top_to_bottom() -> None:
    assert len(BLOCKS) == 6
    names: dict[str, object] = {"__name__": "page"}
    for block in BLOCKS:
        exec(compile(block, "explainers.md", "exec"), names)


@pytest.mark.slow
def test_the_commands_run(run_cli: RunCli, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(BLOCKS[0].partition("entry =")[0])
    commands = re.findall(r"^xmarl-bench (score .*)$", PAGE, flags=re.MULTILINE)
    assert len(commands) == 2
    for command in commands:
        arguments = command.replace("own.py", str(tmp_path / "own.py")).split()
        ran = run_cli(*arguments, "--episodes", 1, "--timesteps", 2, "--max-cycles", 3, "--out", tmp_path)
        assert ran.code == 0, ran.err


def test_the_table_of_questions_says_what_each_shipped_explainer_declares() -> None:
    table = PAGE.split("| shipped | absence | asks |\n|---|---|---|\n")[1].split("\n\n")[0]
    said: dict[str, str] = {}
    for line in table.splitlines():
        names, absence, _ = line.strip("| ").split(" | ")
        said |= dict.fromkeys(re.findall("`(.+?)`", names), absence)
    assert said == {
        each.name: "-" if each.absence is None else f"`{each.absence}`" for each in shipped_explainers()
    }


def test_every_declaration_is_in_the_table() -> None:
    rows = "\n".join(line for line in PAGE.splitlines() if line.startswith("|"))
    assert [name for name in DECLARATIONS if f"`{name}`" not in rows] == []
    ours = {"explain", "control", "fit", "fitted_on", "simulator", "origin"}  # of the harness
    assert {each.name for each in fields(Explainer)} - ours <= set(DECLARATIONS)
