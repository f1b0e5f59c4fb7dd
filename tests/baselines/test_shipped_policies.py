"""Every registered policy loads, is registered under its own name and can be scored."""

from __future__ import annotations

from pathlib import Path

import pytest
from xmarl_envs import TASKS

from tests.baselines.reference import shipped_name
from xmarl_bench.entry.file import read_entry, write_entry
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.policy import load_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.evaluation import Performance, evaluate
from xmarl_bench.scoring.score import score

pytestmark = pytest.mark.slow


def test_every_shipped_policy_loads_and_one_of_each_kind_scores(tmp_path: Path) -> None:
    policies = find_policies()
    assert len(policies) >= 6  # three tasks, with the attention-entropy term and without
    seen = set()
    for name, folder in policies.items():
        _, card = load_policy(folder)
        assert card.name == name
        kind = (card.task, card.family)
        if kind in seen:
            continue
        seen.add(kind)
        entry = score(name, "attention", episodes=1, timesteps=5, max_cycles=40, behaviour_episodes=0)
        (cell,) = entry.results
        assert (cell.task, cell.n_agents) == (card.task, card.n_agents)
        assert cell.metrics.gef is not None
        assert cell.metrics.fid_plus.n_nan == cell.metrics.gef.n_nan == 0
        dependence = cell.metrics.communication_dependence.value
        assert dependence is not None, name
        assert dependence > 0.0, f"{name} ignores messages: every explanation of it is trivially faithful"
        assert read_entry(write_entry(tmp_path, entry)) == entry


def test_success_in_cards_is_reproduced() -> None:
    """Success over the first eighth of the card's episodes agrees with the card.

    The tolerance of 0.15 covers the other episodes (2.5 standard errors if one in ten fails) and the rounding
    of another processor.
    """
    for task in TASKS:
        name = shipped_name(task)
        policy, card = load_policy(find_policies()[name])
        claimed = Performance(**card.performance)
        (measured,) = evaluate(
            [(policy, Cell(card.task, card.n_agents))],
            Sampling(episodes=claimed.episodes // 8, seed=claimed.seed),
        )
        for mine, theirs in (
            (measured.with_messages, claimed.with_messages),
            (measured.without_messages, claimed.without_messages),
        ):
            assert mine["success_rate"] == pytest.approx(theirs["success_rate"], abs=0.15), name
