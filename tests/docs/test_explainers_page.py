"""Code and commands of docs/explainers.md run unchanged."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from tests.bench.checks.test_explainer_checks import PROCESS
from tests.bench.explain.test_other_libraries import BY_ROWS, OF_CAPTUM, OF_GRAPH_EXPLAIN, OF_SHAP
from tests.bench.explain.test_pyg import EVERY
from tests.conftest import RunCli
from tests.helpers.libraries import BLOCKS, PAGE, library
from tests.helpers.shipped import shipped_explainers
from xmarl_bench.checks.explainer_checks import CHECKS
from xmarl_bench.explain.declarations import DECLARATIONS
from xmarl_bench.explain.explainer import Explainer


@pytest.mark.slow
@pytest.mark.usefixtures("short_episodes")
def test_the_code_runs_from_top_to_bottom() -> None:
    assert len(BLOCKS) == 9
    for name in ("captum", "graph_explain", "shap"):
        library(name)
    names: dict[str, object] = {"__name__": "page"}
    for block in BLOCKS:
        exec(compile(block, "explainers.md", "exec"), names)


COMMANDS = re.findall(r"^xmarl-bench ((?:check|compare|score) .*?)(?: {3,}#.*)?$", PAGE, flags=re.MULTILINE)
SMALL = ("--episodes", 2, "--timesteps", 2, "--max-cycles", 3, "--behaviour-episodes", 0)


@pytest.mark.slow
@pytest.mark.usefixtures("short_episodes")
def test_the_commands_run(run_cli: RunCli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(BLOCKS[0].partition("entry =")[0])
    shells = re.findall(r"^```sh\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
    assert set(re.findall(r"^```(\w+)$", PAGE, flags=re.MULTILINE)) == {"python", "sh"}
    assert len(COMMANDS) == sum(len(shell.splitlines()) for shell in shells)
    own, of_pyg, check, compare = (command.split() for command in COMMANDS)
    for command in (own, of_pyg, [*own[:4], "gnn_explainer"]):
        assert run_cli(*command, *SMALL, "--out", "results").code == 0
    monkeypatch.delitem(CHECKS, PROCESS)
    assert run_cli(*check, "--timesteps", 2).code == 0
    compared = run_cli(*compare, "--entries", "results")
    assert compared.code == 0, compared.err
    assert "attention - gnn_explainer" in compared.out
    assert Path("comparison.png").stat().st_size > 10_000


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
    ours = {
        "explain",
        "control",
        "fit",
        "fitted_on",
        "simulates",
        "simulator",
        "origin",
        "elsewhere",
        "device",
    }  # of the harness
    assert {each.name for each in fields(Explainer)} - ours <= set(DECLARATIONS)


def test_the_table_of_other_libraries_lists_what_is_tested() -> None:
    table = PAGE.split("These run unmodified")[1].split("|---|---|---|\n")[1].split("\n\n")[0]
    said: dict[str, set[str]] = {}
    for line in table.splitlines():
        library_name, names, _ = line.strip("| ").split(" | ")
        said.setdefault(library_name.strip("`"), set()).update(re.findall("`(.+?)`", names))
    of_pyg = {type(each.algorithm()).__name__ for each in EVERY.values()}
    assert said.pop("torch_geometric") == of_pyg
    assert said.pop("torch_geometric.contrib") == {"PGMExplainer"}  # tests/bench/explain/test_node_importance
    assert said.pop("captum") == set(OF_CAPTUM)
    assert said.pop("shap") == set(OF_SHAP)
    assert said.pop("lightshap") == {
        name.split()[0] for name in BY_ROWS.keys() - OF_CAPTUM.keys() - OF_SHAP.keys()
    }
    assert said.pop("graph-explain") == set(OF_GRAPH_EXPLAIN)
    assert said == {}
