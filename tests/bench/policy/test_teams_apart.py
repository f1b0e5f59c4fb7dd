"""Many teams in one forward pass: same bits as alone, and the policy's actions up to rounding."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from xmarl_bench.policy import Architecture, GraphPolicy
from xmarl_bench.policy.architecture import Memory
from xmarl_bench.policy.teams_apart import step_teams

OBS_DIM = 7
NETWORKS = {
    "navigation": {"gat_width": 32, "decoder": (256, 256), "residual": True},
    "passage": {"encoder": (32, 32), "encoder_activation": "relu", "gat_width": 32, "decoder": (64, 64)},
    "odd widths": {
        "encoder": (5,), "encoder_activation": "elu", "gat_width": 33, "gat_activation": "silu",
        "decoder": (17,), "decoder_activation": "elu",
    },
    "no decoder": {"gat_width": 3, "gat_activation": "leaky_relu", "decoder": (), "residual": True},
    "categorical": {"gat_width": 16, "decoder": (16,), "distribution": "categorical", "action_dim": 5},
    "memory": {"gat_width": 8, "decoder": (8,), "memory": Memory(cell="gru", width=6, after=1)},
}  # fmt: skip


def network(name: str) -> GraphPolicy:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        tanh = dict.fromkeys(("encoder_activation", "gat_activation", "decoder_activation"), "tanh")
        options = {**tanh, "encoder": (), "action_dim": 2, **NETWORKS[name]}
        return GraphPolicy(Architecture(obs_dim=OBS_DIM, **options)).eval()  # type: ignore[arg-type]


def teams_of(policy: GraphPolicy, n_teams: int, n_agents: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 2.0 * torch.randn(n_teams, n_agents, OBS_DIM + policy.memory_dim, generator=generator)


def differing(name: str, n_agents: int, sizes: list[int], seed: int = 0) -> list[int]:
    """The batch sizes at which some team's bits differ from those alone, for any order and other teams."""
    policy = network(name)
    step = step_teams(policy)
    with torch.inference_mode():
        teams = teams_of(policy, 200, n_agents, seed)
        alone = torch.cat([step(team.clone(), None)[0] for team in teams.split(1)])
        order = torch.randperm(200, generator=torch.Generator().manual_seed(seed + 1))
        return [n for n in sizes if not torch.equal(step(teams[order[:n]], None)[0], alone[order[:n]])]


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
@settings(max_examples=8, deadline=None)
@given(
    n_agents=st.integers(1, 10),
    sizes=st.lists(st.integers(1, 200), min_size=1, max_size=6),
    seed=st.integers(0, 2**16),
)
def test_a_team_has_the_same_bits_as_alone(name: str, n_agents: int, sizes: list[int], seed: int) -> None:
    assert differing(name, n_agents, sizes, seed) == []


@pytest.mark.slow
@pytest.mark.parametrize("instructions", ["AVX2", "SSE4_2"])
def test_bits_are_the_same_with_fewer_vector_instructions(instructions: str) -> None:
    environment = {
        **os.environ,
        "ATEN_CPU_CAPABILITY": "avx2" if instructions == "AVX2" else "default",
        "MKL_ENABLE_INSTRUCTIONS": instructions,
        "ONEDNN_MAX_CPU_ISA": "AVX2" if instructions == "AVX2" else "SSE41",
    }
    code = (
        f"from {__name__} import NETWORKS, differing\n"
        "print([(x, n) for x in NETWORKS for n in (1, 3, 5, 10) if differing(x, n, [1, 2, 7, 33, 50, 200])])"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert ran.stdout == "[]\n", ran.stderr


@pytest.mark.parametrize("name", NETWORKS)
def test_actions_and_memory_equal_the_policy_s(name: str) -> None:
    policy = network(name)
    step = step_teams(policy)
    mask = torch.rand(4, 4, generator=torch.Generator().manual_seed(3))
    with torch.inference_mode():
        teams = teams_of(policy, 50, 4, seed=2)
        for given_mask in (None, mask):
            choice, memory = step(teams, given_mask)
            taken, remembered = policy.step(teams, given_mask)
            torch.testing.assert_close(choice, taken.choice, atol=1e-6, rtol=1e-5)
            torch.testing.assert_close(memory, remembered, atol=1e-6, rtol=1e-5)
