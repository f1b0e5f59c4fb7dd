"""Task performance with and without messages, equal for any number of processes."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from xmarl_envs import make_task

from tests.helpers.policies import small_policy
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.rollout.evaluation import Performance, evaluate, evaluate_policy


def test_performance_is_the_mean_over_episodes() -> None:
    policy, sampling = small_policy(8), Sampling(episodes=3, max_cycles=15)
    (performance,) = evaluate([(policy, Cell("blind_passage_v0", 3))], sampling)
    task = make_task("blind_passage_v0", 3)
    heard = roll_out(task, policy, sampling.seeds, max_cycles=15)
    unheard = roll_out(task, policy, sampling.seeds, max_cycles=15, mask=torch.eye(3))
    for means, episodes in ((performance.with_messages, heard), (performance.without_messages, unheard)):
        assert means["reward"] == pytest.approx(np.mean([episode.reward for episode in episodes]))
        assert means["no_object_collision"] is not None
    gain = performance.messages_gain["reward"]
    difference = np.mean([a.reward - b.reward for a, b in zip(heard, unheard, strict=True)])
    assert gain["value"] == pytest.approx(difference)
    assert gain["low"] <= gain["value"] <= gain["high"]
    assert difference != 0.0


@pytest.mark.parametrize(("low", "helps"), [(-0.1, False), (0.0, False), (0.01, True)])
def test_messages_help_if_the_interval_excludes_zero(low: float, helps: bool) -> None:
    gain = {
        "success_rate": {"value": 0.2, "low": low, "high": 0.4},
        "reward": {"value": 0.0, "low": -1.0, "high": 1.0},
    }
    performance = Performance("blind_passage_v0", 3, 50, 0, 300, {}, {}, None, gain)
    assert performance.messages_help is helps


@pytest.mark.slow
def test_parallel_episodes_do_not_change_the_result() -> None:
    pairs = [
        (small_policy(6), Cell("blind_navigation_v0", 3)),
        (small_policy(5), Cell("blind_discovery_v0", 4)),
    ]
    sampling = Sampling(episodes=3, max_cycles=10)
    assert evaluate(pairs, sampling) == evaluate(pairs, sampling, parallel_episodes=1)


def test_the_record_fits_a_policy_card(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xmarl_envs.BlindNavigation.default_max_cycles", 5)
    record = evaluate_policy(small_policy(6), "blind_navigation_v0", 3, episodes=2)
    assert json.loads(json.dumps(record)) == record
    assert (record["episodes"], record["max_cycles"]) == (2, 5)
    assert record["with_messages"]["no_object_collision"] is None


def test_one_episode_does_not_show_that_messages_help() -> None:
    (performance,) = evaluate(
        [(small_policy(6), Cell("blind_navigation_v0", 3))], Sampling(episodes=1, max_cycles=5)
    )
    assert performance.messages_gain == {}
    assert performance.messages_help is None


def test_a_policy_whose_messages_are_zero_performs_the_same_without_them() -> None:
    policy: GraphPolicy = small_policy(6)
    with torch.no_grad():
        policy.gat.lin_l.weight.zero_()  # every message is zero
        policy.gat.lin_l.bias.zero_()
    (performance,) = evaluate([(policy, Cell("blind_navigation_v0", 3))], Sampling(episodes=2, max_cycles=5))
    assert performance.with_messages == performance.without_messages
    assert performance.messages_gain["reward"] == {"value": 0.0, "low": 0.0, "high": 0.0}
    assert not performance.messages_help
