"""What a policy costs that is acted out: under zero, and under the other absence models: `make bench`.

Attention and the random control on the default navigation policies, as `make score` plays them: 50 episodes
under zero, the first 10 under the three others. Seconds of CPU, on one thread.
"""

from __future__ import annotations

import time

import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from xmarl_baselines.explainers.attention import attention

from tests.benchmarks.conftest import Report
from xmarl_bench.entry.protocol import ABSENCE_EPISODES
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.policy import load_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.default_policies import default_policies
from xmarl_bench.reproducible import episode_seeds
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.reference_states import reference_states
from xmarl_bench.scoring.behaviour import BLOCK, BehaviourBlock, Played

TASK = "blind_navigation_v0"


@pytest.mark.parametrize("n_agents", [3, 5])
def test_the_other_absence_models_cost_less_than_twice_zero(
    benchmark: BenchmarkFixture, n_agents: int, report: Report
) -> None:
    cards = default_policies([load_card(folder) for folder in find_policies().values()])
    name = next(
        each.name
        for each in cards
        if (each.task, each.n_agents) == (TASK, n_agents) and each.attention_entropy > 0
    )
    policy, card = load_policy(find_policies()[name])
    reference = reference_states(policy, Cell(card.task, n_agents))
    spent = {"zero": 0.0, "others": 0.0}

    def act_out() -> None:
        for name, states, episodes in (("zero", None, BLOCK), ("others", reference, ABSENCE_EPISODES)):
            started = time.process_time()
            for explainer in (attention, None):
                seeds = tuple(episode_seeds(0, episodes))
                block = BehaviourBlock(policy, explainer, Cell(card.task, n_agents), seeds, 0, None, states)
                assert isinstance(block.run(), Played)
            spent[name] = time.process_time() - started

    benchmark.pedantic(act_out, rounds=1)  # type: ignore[no-untyped-call]
    line = f"{card.name}: zero {spent['zero']:.1f} s, the others {spent['others']:.1f} s"
    report("behaviour, seconds of CPU", line)
    assert spent["others"] < 2 * spent["zero"]
