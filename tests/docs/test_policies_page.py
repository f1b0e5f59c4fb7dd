"""docs/policies.md: its examples run, and its bounds are those of the code."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from xmarl_baselines.training.recipes import recipe_for
from xmarl_baselines.training.trainer import Run, build

from tests.bench.policy.test_benchmarl import checkpoint
from tests.bench.policy.test_benchmarl_config import CONFIG
from tests.bench.policy.test_layers import GAT2, random_policy, record
from tests.bench.policy.test_memory import torchrl_key_map
from tests.conftest import RunCli
from tests.helpers.policies import random_observations
from xmarl_bench import CompleteGraph, PolicyModule, load_policy, score
from xmarl_bench.origin.references import origin_of
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.plugins.registry import open_policy
from xmarl_bench.policy.architecture import MAX_LAYER_WIDTH, EdgeFeatures, Memory
from xmarl_bench.policy.build import weights_of
from xmarl_bench.policy.shapes import MAX_PARAMETERS
from xmarl_bench.submission.consistency import entry_findings

PAGE = (Path(__file__).parents[2] / "docs" / "policies.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)


def test_the_bundle_of_the_page_loads(tmp_path: Path) -> None:
    exec(compile(blocks("python")[0], "policies.md", "exec"), {"folder": tmp_path})
    policy, card = load_policy(tmp_path)
    assert card.name == "mine"
    assert not policy.row_wise


@pytest.mark.slow
def test_the_networks_of_the_page_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(blocks("python")[1])
    policy, card = open_policy(f"{tmp_path}/mine.py:make", trust_code=True)
    assert card.architecture.graph == CompleteGraph(loops=False)
    assert policy.row_wise
    entry = score((policy, card), "attention", episodes=1, timesteps=3, max_cycles=4, behaviour_episodes=0)
    assert entry.policy.trusted_code
    assert list(entry_findings(entry)) == []
    layer: dict[str, Any] = {}
    exec(compile(blocks("python")[2], "policies.md", "exec", dont_inherit=True), layer)
    network = layer["MyAttention"]()
    policy, _ = open_module(PolicyModule("mine", network, "blind_navigation_v0", 3), origin_of(network))
    alpha = policy.attention(random_observations(2, 3, 6))
    torch.testing.assert_close(alpha.sum(dim=-1), torch.ones(2, 3))


@pytest.mark.slow
def test_the_discrete_policy_of_the_page_is_scored() -> None:
    (code,) = [block for block in blocks("python") if '"categorical"' in block]
    page: dict[str, Any] = {}
    exec(compile(code, "policies.md", "exec", dont_inherit=True), page)
    entry = score(page["make"](), "gradient", episodes=1, timesteps=3, max_cycles=4, behaviour_episodes=0)
    assert list(entry_findings(entry)) == []
    assert entry.policy.architecture.action_dim == 5
    continuous = score(
        "navigation-n3-residual-lambda0-seed0",
        "gradient",
        episodes=1,
        timesteps=3,
        max_cycles=4,
        behaviour_episodes=0,
    )
    assert entry.protocol != continuous.protocol  # they share no table


@pytest.mark.slow
def test_the_recurrent_network_of_the_page_is_accepted(tmp_path: Path) -> None:
    (text,) = [text for text in blocks("python") if "initial_state" in text]
    (tmp_path / "mine.py").write_text(text)
    policy, card = open_policy(f"{tmp_path}/mine.py:make", trust_code=True)
    assert policy.memory_dim == 32
    entry = score((policy, card), "attention", episodes=1, timesteps=3, max_cycles=4, behaviour_episodes=0)
    assert list(entry_findings(entry)) == []


def test_the_memory_of_the_page_is_a_record() -> None:
    (text,) = re.findall(r'`"memory": ({.*})`', PAGE)
    assert Memory.model_validate_json(text).after == 0


def test_the_edge_features_of_the_page_are_a_record() -> None:
    (text,) = re.findall(r'`({"position": .*})`', PAGE)
    assert EdgeFeatures.model_validate_json(text).width == 5


def test_the_key_map_of_the_page_is_valid() -> None:
    assert [json.loads(text) for text in blocks("json")] == [torchrl_key_map("gru")]


@pytest.mark.slow
def test_the_commands_of_the_page_convert(
    tmp_path: Path, run_cli: RunCli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each reads a file of the kind that the page tells."""
    monkeypatch.chdir(tmp_path)
    for folder in ("runs/mine", "run/checkpoints"):
        (tmp_path / folder).mkdir(parents=True)
    policy = random_policy(record(GAT2))
    torch.save({"model": weights_of(policy)}, "model.pt")
    torch.save({"net": weights_of(policy)}, "actor.pt")
    Path("architecture.json").write_text(policy.architecture.model_dump_json())
    Path("keys.json").write_text('{"net.": ""}')
    for path in ("run/checkpoints/checkpoint_60.pt", "checkpoint_60.pt"):
        torch.save(checkpoint(), path)
    Path("run/config.pkl").write_bytes(CONFIG)
    recipe = recipe_for("blind_discovery_v0", frames=64, n_envs=2, n_steps=4, batch_size=8)
    build(Run(recipe), seed=0).save("runs/mine/checkpoint.zip")
    commands = [
        shlex.split(line, comments=True)[1:]
        for block in blocks("sh")
        for line in block.replace("\\\n", " ").splitlines()
    ]
    assert [command[0] for command in commands] == ["convert"] * 5
    for command in commands:
        shutil.rmtree("mine", ignore_errors=True)
        ran = run_cli(*command)
        assert ran.code == 0, ran.err
        if "--out" in command:
            load_policy(Path(command[command.index("--out") + 1]))


def test_bounds_are_those_of_the_code() -> None:
    assert f"{MAX_PARAMETERS:,} parameters" in PAGE
    assert f"together at most {MAX_LAYER_WIDTH}" in PAGE
