"""The checks of policies: shipped and deep policies pass, and every check can fail."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch_geometric.nn import GATv2Conv
from xmarl_envs import BlindNavigation

from tests.bench.policy.test_layers import CARD, GAT2, random_policy, record
from tests.conftest import RunCli
from xmarl_bench.checks import run_checks
from xmarl_bench.checks.policy_checks import CHECKS, LEAST_EPISODES, PolicySubject, check_policy
from xmarl_bench.errors import InputError
from xmarl_bench.metrics.student import interval_of
from xmarl_bench.policy import ModulePolicy, Policy, save_policy
from xmarl_bench.rollout.cell import Cell

CELL = Cell("blind_navigation_v0", 3)
PLAYED = "success above random"


def failed(policy: Policy, *only: str) -> dict[str, str]:
    """Messages of the failed checks on random states; all checks except that of success."""
    states = torch.randn(4, 3, 6, generator=torch.Generator().manual_seed(0))
    chosen = {name: CHECKS[name] for name in only or CHECKS if only or name != PLAYED}
    with torch.no_grad():
        found = list(run_checks(chosen, PolicySubject(policy, CELL, states, LEAST_EPISODES)))
    return {each.check: each.message for each in found if each.passed is False}


class Pilot(nn.Module):
    """Drives to its goal, and a little after the team; `fault` names its fault."""

    def __init__(self, fault: str = "") -> None:
        super().__init__()
        self.fault = fault
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            self.layer = GATv2Conv(6, 2, add_self_loops=False)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        heard = self.layer(x, edge_index)
        loc = -3.0 * x[:, 4:6] + (0.0 if self.fault == "deaf" else 0.3) * torch.tanh(heard)
        if self.fault == "numbers":
            loc = loc + 0.1 * torch.arange(len(x)).remainder(3)[:, None]
        if self.fault == "first edge":
            first = torch.zeros(len(x), 2).index_put((edge_index[1].flip(0),), x[edge_index[0].flip(0), :2])
            loc = loc + first
        if self.fault == "leak":
            teams = (loc.view(-1, 3, 2).mean(dim=1, keepdim=True).expand(-1, 3, -1)).reshape(-1, 2)
            loc = loc + 0.5 * teams
        if self.fault == "noise":
            loc = loc + 0.01 * torch.randn(loc.shape)
        if self.fault == "nan":
            loc = loc / (x[:, :2] * 0.0)
        if self.fault == "lost":
            loc = -loc
        return torch.cat([loc, torch.zeros_like(loc)], dim=-1)


@pytest.mark.slow
def test_a_valid_policy_passes_every_check() -> None:
    found = list(check_policy(ModulePolicy(Pilot(), 6), CELL, timesteps=4, episodes=6))
    assert [each.check for each in found] == list(CHECKS)
    assert [each.message for each in found if not each.passed] == []


@pytest.mark.parametrize(
    ("fault", "fails"),
    [
        ("deaf", {"uses messages"}),
        ("numbers", {"permutation equivariance"}),
        ("first edge", {"permutation equivariance", "blind without messages"}),
        ("leak", {"masks reach their edges", "blind without messages"}),
    ],
)
def test_every_fault_fails_its_checks(fault: str, fails: set[str]) -> None:
    found = failed(ModulePolicy(Pilot(fault), 6))
    assert fails <= set(found) <= {*fails, "permutation equivariance"}
    assert all(said.endswith(".") for said in found.values())


@pytest.mark.slow
def test_a_policy_that_moves_away_from_its_goal_fails_the_check_of_success() -> None:
    assert "not more than chance" in failed(ModulePolicy(Pilot("lost"), 6), PLAYED)[PLAYED]


def test_too_few_episodes_are_refused() -> None:
    """Any policy would fail the check of success: successes that are all equal have no interval."""
    assert interval_of(np.ones(LEAST_EPISODES)) is not None
    assert interval_of(np.ones(LEAST_EPISODES - 1)) is None
    with pytest.raises(InputError, match="3 episodes cannot tell a policy from random actions"):
        list(check_policy(ModulePolicy(Pilot(), 6), CELL, episodes=3))


class Broken(ModulePolicy):
    """Becomes invalid after it was accepted, like weights from a file."""

    def __init__(self, fault: str) -> None:
        pilot = Pilot()
        super().__init__(pilot, 6)
        pilot.fault = fault


@pytest.mark.parametrize(("fault", "fails"), [("noise", "repeats"), ("nan", "output ranges")])
def test_invalid_actions_fail_their_check(fault: str, fails: str) -> None:
    assert fails in failed(Broken(fault))


def test_weights_that_are_not_finite_fail_their_check() -> None:
    policy = ModulePolicy(Pilot(), 6)
    with torch.no_grad():
        policy.network.get_parameter("layer.bias").fill_(torch.nan)
    assert "the first is 'network.layer.bias'" in failed(policy)["finite weights"]


@pytest.mark.slow
def test_the_command_reports_each_check(
    tmp_path: Path, run_cli: RunCli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A deep policy on a radius graph, untrained: only the check of success fails."""
    monkeypatch.setattr(BlindNavigation, "default_max_cycles", 40)
    policy: Any = random_policy(record(GAT2, graph={"kind": "radius", "radius": 1.0}))
    save_policy(tmp_path / "deep", policy, name="deep", **CARD)
    ran = run_cli("check", "policy", tmp_path / "deep", "--timesteps", 4, "--episodes", 6, "--json")
    assert ran.code == 1, ran.err
    found = {each["check"]: each["passed"] for each in json.loads(ran.out)["findings"]}
    assert {check for check, passed in found.items() if passed is False} == {PLAYED}
