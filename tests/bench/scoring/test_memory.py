"""Policies that remember, scored: every explainer and metric answers from the memory that was recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from tests.conftest import RunCli
from tests.helpers.recurrent_policies import (
    TWO_LAYERS,
    AttentionThenGru,
    LstmThenAttention,
    random_weights,
    recurrent_policy,
    remembering,
)
from xmarl_bench import PolicyModule
from xmarl_bench.checks import run_checks
from xmarl_bench.checks.policy_checks import CHECKS, PolicySubject
from xmarl_bench.entry.schema import CellResult
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.origin.references import origin_of
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import GraphPolicy, Policy, PolicyCard, build_policy, load_policy, save_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.scoring.behaviour import BLOCK, BehaviourBlock, Played
from xmarl_bench.scoring.measure import Unit
from xmarl_bench.scoring.piece_keys import Keys
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score_requests
from xmarl_bench.submission.consistency import entry_findings

TASK, D = "blind_navigation_v0", 6
CARD: dict[str, Any] = {"task": TASK, "n_agents": 3, "attention_entropy": 0.0}
EXPLAINERS = ("attention", "occlusion", "gradient", "shapley")  # all others: see test_every_explainer.py


def entries(policy: Policy, card: PolicyCard, explainers: Sequence[str]) -> Iterator[CellResult]:
    """Scored together, so that the team plays once."""
    sampling = Sampling(episodes=2, timesteps=3, max_cycles=8)
    requests = [
        Request(policy, card, find_explainer(name), (Cell(TASK, 3),), sampling, behaviour_episodes=1)
        for name in explainers
    ]
    for entry in entries_of(score_requests(requests)):
        assert list(entry_findings(entry)) == []
        (cell,) = entry.results
        assert cell.controls["all-ones"].fid_minus.value == 0.0
        assert cell.metrics.fid_plus.value is not None
        assert (cell.controls["zeros"].fid_minus.value or 0.0) > 1e-3  # messages matter
        yield cell


@pytest.mark.slow
@pytest.mark.parametrize("make", [AttentionThenGru, LstmThenAttention])
def test_code_is_scored_end_to_end(make: Callable[[], nn.Module]) -> None:
    network = make()
    policy, card = open_module(PolicyModule("mine", network, TASK, 3), origin_of(network))
    for cell in entries(policy, card, EXPLAINERS):
        assert cell.metrics.budgeted_fidelity is not None  # one layer: the oracle tries every row
        assert "success_on_explanation" not in cell.not_measured


@pytest.mark.slow
@pytest.mark.parametrize("after", [0, 1])
def test_a_bundle_is_scored_end_to_end(after: int, tmp_path: Path) -> None:
    """One layer has all absence models, before the memory and after it."""
    save_policy(tmp_path, recurrent_policy(remembering("gru", after)), name="gru", **CARD)
    policy, card = load_policy(tmp_path)
    assert isinstance(policy, GraphPolicy)
    for cell in entries(policy, card, EXPLAINERS):
        for name in ("success_on_explanation", "message_fidelity", "renormalised_budgeted_fidelity"):
            assert name not in cell.not_measured
            assert getattr(cell.metrics, name).value is not None


@pytest.mark.slow
def test_a_bundle_of_several_layers_is_scored_end_to_end(tmp_path: Path) -> None:
    save_policy(tmp_path, recurrent_policy(remembering("lstm", 1, TWO_LAYERS)), name="deep", **CARD)
    for cell in entries(*load_policy(tmp_path), ("attention", "gradient", "occlusion")):
        assert "success_on_explanation" not in cell.not_measured


def watched() -> tuple[list[Tensor], Explainer]:
    seen: list[Tensor] = []

    def watch(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        seen.append(observations.clone())
        return torch.rand(len(observations), 3, 3, generator=generator)

    return seen, Explainer("watch", watch, stochastic=True)


def test_masks_that_explain_a_timestep_move_no_memory() -> None:
    """The explainer is asked about all timesteps of the unmasked team, whatever it says of earlier ones."""
    policy, (seen, watch) = recurrent_policy(remembering("gru", 1)), watched()
    (episode,) = roll_out(Cell(TASK, 3).make(), policy, [1], max_cycles=8)
    Unit(policy, (watch,), episode, 0, None, sanity=False, shared=False).run()
    (observations,) = seen
    np.testing.assert_array_equal(observations.numpy(), episode.observations)


def test_masks_that_a_team_acts_on_move_its_memory() -> None:
    policy, (seen, watch) = recurrent_policy(remembering("gru", 1)), watched()
    played = BehaviourBlock(policy, watch, Cell(TASK, 3), (1, 2), 0, 4).run()
    assert isinstance(played, Played)
    (episode,) = roll_out(Cell(TASK, 3).make(), policy, [1], max_cycles=4)
    kept, dropped, full = seen[1][0], seen[1][BLOCK], torch.from_numpy(episode.observations[1])
    assert torch.equal(seen[0][0], torch.from_numpy(episode.observations[0]))
    for team in (kept, dropped):
        assert (team[:, D:] - full[:, D:]).abs().max() > 1e-3
    assert (kept[:, D:] - dropped[:, D:]).abs().max() > 1e-3
    # The first of the fillers plays on as the first team does: memories belong to their episode.
    assert torch.equal(seen[2][2:BLOCK], seen[2][:1].expand(BLOCK - 2, -1, -1))


@pytest.mark.slow
def test_keys_differ_by_memory(tmp_path: Path) -> None:
    """By where it sits, though the weights have the same names, shapes and numbers; by where it starts."""
    keys = []
    for after in (0, 1, 1):
        layers = ({"conv": "GATv2Conv", "width": 7, "activation": "tanh"},)
        architecture = remembering("gru", after, layers, width=7)
        weights = random_weights(remembering("gru", 0, layers, width=7))
        save_policy(tmp_path, build_policy(architecture, weights), name="gru", **CARD)
        keys.append(Keys().policy(*load_policy(tmp_path)))
    assert keys[1] == keys[2] != keys[0]

    class Late(AttentionThenGru):
        start = 0.0

        def initial_state(self, n: int) -> Tensor:
            return torch.full((n, 5), self.start)

    code = []
    for start in (0.0, 1.0, 0.0):
        network = Late()
        network.start = start
        code.append(Keys().policy(*open_module(PolicyModule("gru", network, TASK, 3), origin_of(network))))
    assert code[0] == code[2] != code[1]


@pytest.mark.slow
@pytest.mark.parametrize("make", [AttentionThenGru, LstmThenAttention])
def test_checks_of_policies_take_it(make: Callable[[], nn.Module]) -> None:
    """All but the one that plays whole episodes."""
    network = make()
    policy, _ = open_module(PolicyModule("mine", network, TASK, 3), origin_of(network))
    (episode,) = roll_out(Cell(TASK, 3).make(), policy, [1], max_cycles=8)
    chosen = {name: check for name, check in CHECKS.items() if name != "success above random"}
    subject = PolicySubject(policy, Cell(TASK, 3), torch.from_numpy(episode.observations), 2)
    with torch.no_grad():
        assert [each.check for each in run_checks(chosen, subject) if not each.passed] == []


@pytest.mark.slow
def test_the_command_line_takes_it(tmp_path: Path, run_cli: RunCli) -> None:
    save_policy(tmp_path / "gru", recurrent_policy(remembering("gru", 1)), name="gru", **CARD)
    ran = run_cli(
        "score", "--policy", tmp_path / "gru", "--explainer", "attention", "--episodes", 2, "--timesteps", 2,
        "--max-cycles", 5, "--out", tmp_path / "out",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    ran = run_cli("evaluate", "--policy", tmp_path / "gru", "--episodes", 2, "--max-cycles", 5)
    assert ran.code == 0, ran.err
