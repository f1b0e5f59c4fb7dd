"""docs/tasks.md: its tasks are scored, and what it says of them holds."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from xmarl_envs.testing import check_task

from tests.conftest import RunCli
from tests.helpers.policies import small_policy
from xmarl_bench import save_policy
from xmarl_bench.entry.file import read_entries
from xmarl_bench.entry.schema import Entry
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.tasks import sources
from xmarl_bench.tasks.parallel_task import AGENT_COLLISION, OBJECT_COLLISION, SUCCESS_KEYS
from xmarl_bench.tasks.parallel_trial import TRIAL_STEPS
from xmarl_bench.tasks.sources import open_task

PAGE = (Path(__file__).parents[2] / "docs" / "tasks.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)


@pytest.fixture(autouse=True)
def nothing_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "_opened", {})


def written(folder: Path, name: str) -> str:
    """The reference of a task of the page, in a file."""
    (code,) = [
        block for block in blocks("python") if re.search(rf"^(def|class) {name}\(", block, re.MULTILINE)
    ]
    (folder / "own_tasks.py").write_text(code)
    return f"{folder / 'own_tasks.py'}:{name}"


def scored(reference: str, run_cli: RunCli, folder: Path) -> Entry:
    """A policy of random weights, bundled for the task and scored as the page says."""
    source = open_task(reference, trust_code=True)
    task: Any = Cell(source.name, 3).make()
    policy = small_policy(task.obs_dim, categorical=not task.continuous_actions)
    save_policy(folder / "p", policy, name="p", task=source.name, n_agents=3, attention_entropy=0.0)
    command = (
        "score",
        "--policy",
        folder / "p",
        "--task",
        reference,
        "--trust-code",
        "--explainer",
        "occlusion",
    )
    quick = ("--episodes", 2, "--timesteps", 3, "--max-cycles", 10, "--out", folder, "--cache", folder / "c")
    ran = run_cli(*command, *quick)
    assert ran.code == 0, ran.err
    ((_, entry),) = read_entries(folder / "entries")
    return entry


@pytest.mark.slow
@pytest.mark.parametrize("name", ["spread", "navigation", "Gather"])
def test_a_task_of_the_page_is_scored(name: str, run_cli: RunCli, tmp_path: Path) -> None:
    entry = scored(written(tmp_path, name), run_cli, tmp_path)
    (cell,) = entry.results
    assert entry.protocol.tasks is not None
    record = entry.protocol.tasks[cell.task]
    assert record.entry_point == f"own_tasks.py:{name}"
    assert record.code_sha256 is not None
    assert ("success_rate" in cell.not_measured) == (name != "Gather")
    assert ("nearest" in cell.controls) == (name == "Gather")
    assert record.environment_distribution == {"spread": "mpe2"}.get(name)


def test_the_entry_point_of_the_page_is_that_of_tasks() -> None:
    (listed,) = tomllib.loads(blocks("toml")[0])["project"]["entry-points"].items()
    assert listed == (sources.GROUP, {"spread": "package.module:spread"})


def test_keys_and_steps_of_the_page_are_those_of_the_code() -> None:
    for key in (*SUCCESS_KEYS, AGENT_COLLISION, OBJECT_COLLISION):
        assert f"`{key}`" in PAGE
    assert TRIAL_STEPS == 5


def test_vmas_takes_thirty_lines() -> None:
    (code,) = [block for block in blocks("python") if "class VmasEnv" in block]
    lines = [line for line in code[code.index("class") :].splitlines() if line.strip()]
    assert len(lines) <= 30


@pytest.mark.slow
def test_the_rules_of_the_page_keep_the_promises_of_tasks(tmp_path: Path) -> None:
    check_task(open_task(written(tmp_path, "Gather"), trust_code=True).factory)
