"""Categorical policies: their metrics, the actions they play, and every command on a bundle and on code."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv
from xmarl_envs import BlindNavigation, VectorEnv, make_task

from tests.bench.policy.test_layers import CARD, GAT2, random_policy, record
from tests.conftest import RunCli
from tests.helpers.dense_reference import reference_distribution
from tests.helpers.policies import random_masks, random_observations, small_policy
from xmarl_bench import PolicyModule, score
from xmarl_bench.checks.policy_checks import CHECKS, check_policy
from xmarl_bench.entry.file import read_entries
from xmarl_bench.entry.protocol import DEFINITIONS
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.policy import ModulePolicy, Policy, load_policy, save_policy
from xmarl_bench.policy.distribution import action_distribution
from xmarl_bench.render.recording import record as record_episode
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.scoring.states import States
from xmarl_bench.submission.consistency import entry_findings

CELL = Cell("blind_navigation_v0", 3)
QUICK: dict[str, Any] = {"episodes": 2, "timesteps": 3, "max_cycles": 5, "behaviour_episodes": 1}
HERE = "tests.bench.policy.test_categorical"


class Pilot(nn.Module):
    """Pushes along the longer axis towards its goal, and a little after the team."""

    def __init__(self) -> None:
        super().__init__()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            self.layer = GATv2Conv(6, 5, add_self_loops=False)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        right, up = (-6.0 * x[:, 4:6] - 3.0 * x[:, 2:4]).T
        nothing = torch.full_like(up, 0.2)
        logits = torch.stack([nothing, -right, right, -up, up], dim=-1)
        return logits + 0.3 * torch.tanh(self.layer(x, edge_index))


def pilot() -> PolicyModule:
    return PolicyModule("pilot", Pilot(), "blind_navigation_v0", 3, distribution="categorical")


def deep() -> Policy:
    policy: Policy = random_policy(record(GAT2, distribution="categorical", action_dim=5))
    return policy


def softmax(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    powers = np.exp(logits - logits.max(axis=-1, keepdims=True))
    return np.asarray(powers / powers.sum(axis=-1, keepdims=True))


def test_logits_give_probabilities_and_the_first_likeliest_action() -> None:
    raw = torch.log(torch.tensor([[2.0, 1.0, 4.0, 4.0, 5.0], [1.0, 3.0, 3.0, 1.0, 0.0]])) + 7.0
    distribution = action_distribution(raw, "categorical")
    torch.testing.assert_close(distribution.action, torch.tensor([[2, 1, 4, 4, 5], [2, 6, 6, 2, 0]]) / 16)
    assert distribution.choice.tolist() == [4, 1]
    assert distribution.divisor == 2


@pytest.mark.parametrize("policy", [small_policy(6, 1, categorical=True), deep()], ids=["one layer", "deep"])
def test_called_as_a_network_it_returns_probabilities(policy: Policy) -> None:
    for x in random_observations(3, 4, 6):
        with torch.no_grad():
            probabilities = policy(x, policy.edges(x))
            torch.testing.assert_close(probabilities, policy.distribution(x[None]).action[0])
        torch.testing.assert_close(probabilities.sum(dim=-1), torch.ones(4))


@pytest.mark.parametrize("communication", [False, True])
def test_metrics_equal_an_independent_dense_reference(communication: bool) -> None:
    policy = small_policy(6, 1, categorical=True)
    observations, masks = random_observations(7, 3, 6), random_masks(7, 3)
    own = np.eye(3) if communication else np.zeros((3, 3))  # kept in subgraph and complement
    plus, minus, kls, dependence = [], [], [], []
    for observation, mask in zip(observations.double().numpy(), masks.double().numpy(), strict=True):
        full, kept, dropped, alone = (
            softmax(reference_distribution(policy, observation, each)[0])
            for each in (np.ones((3, 3)), np.maximum(mask, own), np.maximum(1 - mask, own), np.eye(3))
        )
        plus.append(np.abs(full - dropped).sum(axis=1).mean() / 2)
        minus.append(np.abs(full - kept).sum(axis=1).mean() / 2)
        kls.append((full * np.log(full / kept)).sum(axis=1))
        dependence.append(np.abs(full - alone).sum(axis=1).mean() / 2)
    states = States.of(policy, observations, np.random.default_rng(0), random_observations(30, 3, 6, seed=9))
    metrics, prefix = states.mask_metrics(masks).model_dump(), "comm_" if communication else ""
    assert metrics[f"{prefix}fid_plus"] == pytest.approx(np.mean(plus), abs=1e-6)
    assert metrics[f"{prefix}fid_minus"] == pytest.approx(np.mean(minus), abs=1e-6)
    assert metrics[f"{prefix}gef"] == pytest.approx(np.mean(1 - np.exp(-np.array(kls))), abs=1e-6)
    if not communication:
        assert metrics["median_kl"] == pytest.approx(np.median(kls), rel=1e-4)
    assert states.policy_metrics().communication_dependence == pytest.approx(np.mean(dependence), abs=1e-6)
    assert all(value is not None for value in metrics.values())  # under every absence model too


@pytest.mark.slow
def test_the_likeliest_action_is_played_on_the_discrete_task() -> None:
    policy = pilot_policy()
    (episode,) = roll_out(make_task("blind_navigation_v0", 3), policy, [5], max_cycles=30)
    env = VectorEnv(make_task("blind_navigation_v0", 3, continuous_actions=False), max_cycles=30)
    observation = env.reset([5])
    for seen in episode.observations:
        np.testing.assert_array_equal(observation[0], seen)
        with torch.no_grad():
            x = torch.tensor(observation)
            action = policy(x[0], policy.edges(x[0])).argmax(dim=-1).numpy()
        observation = env.step(action[None]).observation
    drawn = record_episode(make_task("blind_navigation_v0", 3), "pilot", policy, max_cycles=30)
    (again,) = roll_out(make_task("blind_navigation_v0", 3), policy, [drawn.seed], max_cycles=30)
    np.testing.assert_array_equal(drawn.observations, again.observations)


def pilot_policy() -> ModulePolicy:
    return ModulePolicy(Pilot(), 6, 5, distribution="categorical")


@pytest.mark.slow
@pytest.mark.parametrize("explainer", ["attention", "shapley-messages"])
def test_bundle_and_code_are_scored_end_to_end(explainer: str, tmp_path: Path) -> None:
    save_policy(tmp_path / "small", small_policy(6, 1, categorical=True), name="small", **CARD)
    entries = [score(each, explainer, **QUICK) for each in (tmp_path / "small", pilot())]
    for entry in entries:
        assert list(entry_findings(entry)) == []
        (cell,) = entry.results
        assert cell.metrics.fid_plus.value is not None
        assert 0 < cell.metrics.fid_plus.value <= 1
        assert cell.metrics.gef.value is not None
        assert cell.controls["all-ones"].fid_minus.value == 0.0
        assert entry.protocol.definitions["fid_minus"].endswith(
            "total variation distance of F_i(1) and F_i(m)"
        )
        assert "of the categoricals" in entry.protocol.definitions["gef"]
        assert Entry.model_validate_json(entry.model_dump_json()) == entry
    changed = entries[0].protocol.model_copy(update={"definitions": DEFINITIONS})
    assert "protocol.definitions disagree with those of xmarl-3." in list(
        entry_findings(entries[0].model_copy(update={"protocol": changed}))
    )
    assert (
        "resample_budgeted_fidelity" not in entries[0].results[0].not_measured
    )  # its coefficients are known


@pytest.mark.slow
def test_saving_and_loading_keeps_the_bundle(tmp_path: Path) -> None:
    memory = {"cell": "gru", "width": 4, "after": 1}
    recurrent = random_policy(record(GAT2, distribution="categorical", action_dim=5, memory=memory))
    policies = {"small": small_policy(6, 1, categorical=True), "deep": deep(), "recurrent": recurrent}
    for name, policy in policies.items():
        saved: Any = policy
        save_policy(tmp_path / name, saved, name=name, **CARD)
        loaded, card = load_policy(tmp_path / name)
        assert (card.architecture.distribution, card.architecture.action_dim) == ("categorical", 5)
        assert type(loaded) is type(policy)
        assert not loaded.continuous_actions
        x = random_observations(3, 3, 6 + loaded.memory_dim)
        with torch.no_grad():
            assert torch.equal(loaded.distribution(x).action, policy.distribution(x).action)


@pytest.mark.slow
def test_a_valid_policy_passes_every_check() -> None:
    found = list(check_policy(pilot_policy(), CELL, timesteps=4, episodes=6))
    assert [each.check for each in found] == list(CHECKS)
    assert [each.message for each in found if not each.passed] == []
    assert any("probabilities of actions 0." in each.message for each in found)


@pytest.mark.slow
def test_every_command_accepts_a_categorical_policy(
    tmp_path: Path, run_cli: RunCli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BlindNavigation, "default_max_cycles", 12)
    code = ("--policy", f"{HERE}:pilot", "--trust-code")
    ran = run_cli("score", *code, "--explainer", "occlusion", "--episodes", 1, "--out", tmp_path / "results")
    assert ran.code == 0, ran.err
    ((_, entry),) = read_entries(tmp_path / "results" / "entries")
    assert entry.policy.architecture.distribution == "categorical"
    ran = run_cli("evaluate", *code, "--episodes", 6, "--json")
    assert ran.code == 0, ran.err
    save_policy(tmp_path / "small", small_policy(6, 1, categorical=True), name="small", **CARD)
    ran = run_cli("check", "policy", tmp_path / "small", "--timesteps", 4, "--episodes", 6, "--json")
    findings = {each["check"]: each["passed"] for each in json.loads(ran.out)["findings"]}
    assert {check for check, passed in findings.items() if passed is False} <= {"success above random"}
    picture = tmp_path / "team.png"
    ran = run_cli("render", "--policy", tmp_path / "small", "--explainer", "gradient", "--out", picture)
    assert ran.code == 0, ran.err
    assert picture.stat().st_size > 1000


def test_another_number_of_actions_is_refused(tmp_path: Path) -> None:
    policy: Any = random_policy(record(GAT2, distribution="categorical"))
    save_policy(tmp_path / "two", policy, name="two", **CARD)
    with pytest.raises(InputError, match=r"'two' has 2 actions to choose from, blind_navigation_v0 takes 5:"):
        score(tmp_path / "two", "attention", **QUICK)


class FourWide(Pilot):
    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        return super().forward(x, edge_index)[:, 1:]


@pytest.mark.slow
def test_code_with_another_width_is_refused() -> None:
    module = PolicyModule("four", FourWide(), "blind_navigation_v0", 3, distribution="categorical")
    with pytest.raises(InputError, match=r"return \(3, 5\), a logit for each of 5 actions"):
        score(module, "attention", **QUICK)
