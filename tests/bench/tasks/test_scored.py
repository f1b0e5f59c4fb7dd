"""Tasks of others are scored, drawn and checked end to end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpe2 import simple_spread_v3
from PIL import Image
from torch_geometric.nn import GATv2Conv

from tests.bench.tasks import worlds
from tests.conftest import RunCli
from tests.helpers.policies import small_policy
from xmarl_bench import PolicyModule, save_policy, score
from xmarl_bench.board import board_of
from xmarl_bench.board.command import command_of
from xmarl_bench.board.gate import gate_reason
from xmarl_bench.entry.file import read_entries
from xmarl_bench.entry.schema import Entry
from xmarl_bench.policy import GraphPolicy, PolicyCard
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.scoring.piece_keys import Keys
from xmarl_bench.submission.consistency import entry_findings
from xmarl_bench.tasks import sources

HERE = "tests.bench.tasks.worlds"
QUICK = ("--episodes", 2, "--timesteps", 3, "--max-cycles", 8)


@pytest.fixture(autouse=True)
def nothing_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "_opened", {})


def spread_policy() -> tuple[GraphPolicy, dict[str, Any]]:
    card = {"name": "spreader", "task": "spread", "n_agents": 3, "attention_entropy": 0.0}
    return small_policy(18, categorical=True), card


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    policy, card = spread_policy()
    save_policy(tmp_path / "spreader", policy, **card)
    return tmp_path / "spreader"


@pytest.mark.slow
def test_a_bundle_is_scored_on_a_task_of_others(bundle: Path, run_cli: RunCli, tmp_path: Path) -> None:
    where = ("--out", tmp_path / "out", "--cache", tmp_path / "cache")
    command = ["score", "--policy", bundle, "--task", f"{HERE}:spread", "--explainer", "occlusion", *QUICK]
    ran = run_cli(*command, *where, "--trust-code")
    assert ran.code == 0, ran.err
    ((name, entry),) = [(path.name, each) for path, each in read_entries(tmp_path / "out" / "entries")]
    (cell,) = entry.results
    assert (cell.task, cell.n_agents, cell.max_cycles) == ("spread", 3, 8)
    assert entry.protocol.tasks is not None
    record = entry.protocol.tasks["spread"]
    assert record.entry_point == f"{HERE}:spread"
    assert record.code_sha256 is not None
    assert record.environment == "mpe2.simple_spread.simple_spread:raw_env"
    assert record.environment_distribution == "mpe2"
    assert cell.metrics.success_rate is None
    assert cell.metrics.no_agent_collision is None
    assert cell.not_measured["success_rate"].endswith("hold no at_goal, found or is_success")
    for name in ("reward", "reward_on_explanation"):
        assert getattr(cell.metrics, name).value < 0
    assert cell.metrics.message_fidelity.n == 2
    assert "nearest" not in cell.controls
    assert f"--task {HERE}:spread" in command_of(entry)
    assert "--trust-code" in command_of(entry)
    assert board_of([(name, entry)])["tables"][0]["task"] == "spread"


def scored(task: object) -> Entry:
    policy, card = spread_policy()
    opened = policy, PolicyCard(architecture=policy.architecture, weights_sha256="0" * 64, **card)
    return score(opened, "attention", task=task, episodes=2, timesteps=2, max_cycles=4, behaviour_episodes=0)  # type: ignore[arg-type]


class Overflowing(worlds.Line):
    def step(self, actions: Any) -> Any:
        seen, rewards, *rest = super().step(actions)
        return seen, dict.fromkeys(rewards, np.inf) if self.cycle == 3 else rewards, *rest


def overflowing(n_agents: int) -> Overflowing:
    return Overflowing(n_agents)


@pytest.mark.slow
def test_an_entry_says_that_rewards_are_not_finite() -> None:
    policy = small_policy(2)
    card = {"name": "liner", "task": "overflowing", "n_agents": 3, "attention_entropy": 0.0}
    opened = policy, PolicyCard(architecture=policy.architecture, weights_sha256="0" * 64, **card)  # type: ignore[arg-type]
    entry = score(opened, "attention", task=overflowing, episodes=2, timesteps=2)
    (cell,) = entry.results
    why = "every episode has a reward that is NaN or infinite"
    for name in ("reward", "reward_gain", "reward_on_explanation", "reward_on_complement"):
        assert getattr(cell.metrics, name) is None
        assert cell.not_measured[name] == why
    assert cell.metrics.fid_delta.n == 2
    (policy,) = board_of([("x.json", entry)])["tables"][0]["policies"]
    assert policy["gate"] == "messages are not shown to help: no gain is measured"


@pytest.mark.slow
def test_tasks_of_the_same_name_and_other_code_share_no_table() -> None:
    def spread(n_agents: int) -> object:
        return simple_spread_v3.parallel_env(N=n_agents, local_ratio=0.0, continuous_actions=False)

    theirs, ours = scored(worlds.spread), scored(spread)
    assert theirs.entry_id == scored(worlds.spread).entry_id
    assert len(board_of([("a", theirs), ("b", theirs)])["tables"]) == 1
    assert len(board_of([("a", theirs), ("b", ours)])["tables"]) == 2


def test_the_key_of_a_task_covers_its_code() -> None:
    def spread(n_agents: int) -> object:
        return simple_spread_v3.parallel_env(N=n_agents, local_ratio=0.0, continuous_actions=False)

    keys = []
    for factory in (worlds.spread, worlds.spread, spread):
        sources.open_task(factory)
        keys.append(Keys().task(Cell("spread", 3)))
    assert keys[0] is not None
    assert keys[0] == keys[1] != keys[2]
    assert Keys().task(Cell("blind_navigation_v0", 3)) is None


@pytest.mark.slow
def test_where_no_success_is_told_reward_decides_whether_explanations_are_ranked() -> None:
    (cell,) = scored(worlds.spread).results
    gain = cell.metrics.reward_gain
    better = gain.model_copy(update={"value": 1.0, "interval": (0.5, 1.5)})
    worse = gain.model_copy(update={"value": 1.0, "interval": (-0.5, 1.5)})
    assert gate_reason(cell.metrics.model_copy(update={"reward_gain": better})) is None
    said = gate_reason(cell.metrics.model_copy(update={"reward_gain": worse}))
    assert said is not None
    assert "reward gained by messages 1.000 (-0.500 to 1.500)" in said


@pytest.mark.slow
def test_a_task_class_of_one_s_own_is_scored() -> None:
    policy = small_policy(6)
    card = PolicyCard(
        name="far", task="farther_v0", n_agents=3, attention_entropy=0.0, architecture=policy.architecture,
        weights_sha256="0" * 64,
    )  # fmt: skip
    quick = {"episodes": 2, "timesteps": 3, "max_cycles": 8}
    entry = score((policy, card), "attention", task=worlds.Farther, **quick)  # type: ignore[arg-type]
    assert entry.protocol.tasks is not None
    assert entry.protocol.tasks["farther_v0"].entry_point == f"{HERE}:Farther"
    assert "nearest" in entry.results[0].controls
    assert entry.results[0].metrics.success_rate.value is not None
    assert any("the task 'farther_v0' is unknown" in finding for finding in entry_findings(entry))


@pytest.mark.slow
def test_a_policy_module_brings_its_task() -> None:
    module = PolicyModule("liner", GATv2Conv(2, 4, add_self_loops=False), worlds.told, 3)
    entry = score(module, "random", episodes=2, timesteps=2)
    assert entry.results[0].metrics.success_rate.value == pytest.approx(2 / 3)
    assert entry.results[0].metrics.no_agent_collision.value == 0.0
    assert entry.results[0].max_cycles == 6


@pytest.mark.slow
def test_an_episode_is_drawn_with_the_explanation(bundle: Path, run_cli: RunCli, tmp_path: Path) -> None:
    common = ("--task", f"{HERE}:spread_drawn", "--trust-code", "--max-cycles", 6)
    ran = run_cli("render", *common, "--policy", "random", "--out", tmp_path / "random.png")
    assert ran.code == 0, ran.err
    with Image.open(tmp_path / "random.png") as picture:
        colours = picture.convert("RGB").getcolors(10**6)
    assert colours is not None
    assert run_cli("render", *common, "--policy", "heuristic", "--out", tmp_path / "x.png").code == 2
    common = ("--task", f"{HERE}:spread", *common[2:])
    out = tmp_path / "explained.gif"
    ran = run_cli("render", *common, "--policy", bundle, "--explainer", "attention", "--out", out)
    assert ran.code == 0, ran.err
    assert "success nan" not in ran.out


@pytest.mark.slow
def test_a_policy_is_checked_on_it(bundle: Path, run_cli: RunCli) -> None:
    ran = run_cli("check", "policy", bundle, "--episodes", 6, "--task", f"{HERE}:spread", "--trust-code")
    assert "reward" in ran.out
    assert ran.code in (0, 1), ran.err
