"""Which seed stands for a cell."""

from __future__ import annotations

from typing import Any

import pytest

from tests.policies import small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.policy import PolicyCard
from xmarl_bench.policy.default_policies import default_policies
from xmarl_bench.scoring.selection import select_policies


def card(name: str, success: float, free: float | None = 1.0, **fields: Any) -> PolicyCard:
    heard = {"success_rate": success, "no_agent_collision": free, "no_object_collision": None}
    record: dict[str, Any] = {
        "task": "blind_navigation_v0", "n_agents": 3, "attention_entropy": 0.0,
        "performance": {"with_messages": heard}, **fields,
    }  # fmt: skip
    return PolicyCard(name=name, architecture=small_policy(6).architecture, weights_sha256="0" * 64, **record)


def test_success_to_two_digits_comes_first_then_collisions() -> None:
    cards = [card("a", 0.92, 1.0), card("b", 0.981, 0.5), card("c", 0.979, 0.7), card("d", 0.98, 0.7)]
    assert [each.name for each in default_policies(cards)] == ["c"]


def test_one_for_each_task_team_size_and_regulariser() -> None:
    cards = [
        card("plain", 0.5),
        card("regularised", 0.5, attention_entropy=0.1),
        card("stronger", 0.6, attention_entropy=10.0),
        card("larger", 0.1, n_agents=4),
        card("elsewhere", 0.1, None, task="blind_discovery_v0"),
    ]
    names = {each.name for each in default_policies(cards)}
    assert names == {"plain", "stronger", "larger", "elsewhere"}


def test_checkpoints_and_unmeasured_policies_stand_for_nothing() -> None:
    cards = [card("checkpoint", 1.0, training={"percent": 20}), card("unmeasured", 1.0, performance={})]
    assert default_policies(cards) == []


def test_finished_are_all_but_checkpoints() -> None:
    every, finished = (
        {card.name for _, card, _ in select_policies([name], ["all"], ["all"])}
        for name in ("all", "finished")
    )
    checkpoints = every - finished
    assert checkpoints == {name for name in every if "-at" in name}
    assert len(checkpoints) == 8
    assert finished < every


def test_default_among_the_shipped_ones() -> None:
    chosen = select_policies(["default"], ["blind_discovery_v0"], ["3"])
    assert [(card.task, card.n_agents) for _, card, _ in chosen] == [("blind_discovery_v0", 3)] * 2
    assert [card.attention_entropy > 0 for _, card, _ in chosen] == [False, True]
    with pytest.raises(InputError, match="no policy is installed"):
        select_policies(["default"], ["blind_discovery_v0"], ["7"])
