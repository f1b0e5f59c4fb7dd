"""The selection of a cell's best seed, and the groups of policies by name."""

from __future__ import annotations

from typing import Any

import pytest

from tests.conftest import MakeBundle
from tests.helpers.policies import small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.policy import PolicyCard
from xmarl_bench.policy.default_policies import default_policies
from xmarl_bench.scoring.selection import explainers_meant, select_policies


def card(name: str, success: float, free: float = 1.0, makespan: float = 100.0, **fields: Any) -> PolicyCard:
    seen = {
        "success_rate": success,
        "no_agent_collision": free,
        "no_object_collision": None,
        "makespan": makespan,
    }
    record: dict[str, Any] = {
        "task": "blind_navigation_v0", "n_agents": 3, "attention_entropy": 0.0, "family": "residual",
        "training": {"validation": seen}, **fields,
    }  # fmt: skip
    return PolicyCard(name=name, architecture=small_policy(6).architecture, weights_sha256="0" * 64, **record)


def test_policies_are_ordered_by_success_and_collisions_then_makespan() -> None:
    cards = [card("a", 1.0, 0.6), card("b", 0.98, 0.95, 80), card("c", 0.97, 0.96, 70), card("d", 0.9, 1.0)]
    assert [each.name for each in default_policies(cards)] == ["c"]


def test_collisions_do_not_count_in_discovery() -> None:
    cards = [card(name, *seen, task="blind_discovery_v0") for name, seen in
             {"bold": (0.95, 0.2), "shy": (0.94, 0.9)}.items()]  # fmt: skip
    assert [each.name for each in default_policies(cards)] == ["bold"]


def test_performance_on_scoring_episodes_does_not_count() -> None:
    heard = {"success_rate": 1.0, "no_agent_collision": 1.0, "no_object_collision": None}
    cards = [card("validated", 0.9), card("lucky", 0.8, performance={"with_messages": heard})]
    assert [each.name for each in default_policies(cards)] == ["validated"]


def test_one_for_each_task_team_size_and_regulariser() -> None:
    cards = [
        card("plain", 0.5),
        card("regularised", 0.5, attention_entropy=0.1),
        card("stronger", 0.6, attention_entropy=10.0),
        card("larger", 0.1, n_agents=4),
        card("elsewhere", 0.1, task="blind_discovery_v0"),
    ]
    names = {each.name for each in default_policies(cards)}
    assert names == {"plain", "stronger", "larger", "elsewhere"}


def test_the_first_family_is_preferred_and_others_fill_missing_cells() -> None:
    others = [card("of-the-paper", 1.0, family="paper"), card("stranger", 0.7, n_agents=4, family=None)]
    assert [each.name for each in default_policies([*others, card("ours", 0.9)])] == ["ours", "stranger"]


def test_checkpoints_and_unvalidated_policies_are_never_default() -> None:
    checkpoint = card("checkpoint", 1.0)
    checkpoint = checkpoint.model_copy(update={"training": {**checkpoint.training, "percent": 20}})
    assert default_policies([checkpoint, card("unvalidated", 1.0, training={})]) == []


def names_of(word: str) -> set[str]:
    return {card.name for _, card, _ in select_policies([word], ["all"], ["all"])}


@pytest.mark.slow
def test_finished_are_all_but_checkpoints_and_contain_the_families() -> None:
    every, finished, residual = (names_of(word) for word in ("all", "finished", "residual"))
    assert every - finished == {name for name in every if "-at" in name}
    assert residual == {name for name in finished if "-residual-" in name}
    assert names_of("default") & residual


def test_defaults_of_the_shipped_policies() -> None:
    chosen = select_policies(["default"], ["blind_discovery_v0"], ["3"])
    assert [(card.task, card.n_agents) for _, card, _ in chosen] == [("blind_discovery_v0", 3)] * 2
    assert [card.attention_entropy > 0 for _, card, _ in chosen] == [False, True]
    deployed = select_policies(["default"], ["blind_discovery_v0"], ["3"], [8, 10, 8])
    assert [card.name for _, card, _ in deployed] == [card.name for _, card, _ in chosen]
    assert [[cell.n_agents for cell in cells] for _, _, cells in deployed] == [[8, 10]] * 2
    with pytest.raises(InputError, match="no policy is installed"):
        select_policies(["default"], ["blind_discovery_v0"], ["7"])


def test_a_policy_given_beside_a_word_is_added(make_bundle: MakeBundle) -> None:
    mine, task = str(make_bundle(task="blind_discovery_v0")), ["blind_discovery_v0"]
    chosen = select_policies(["default", mine, "discovery-n3-paper-lambda0-seed0"], task, ["3", "4"])
    added = {card.name: [cell.n_agents for cell in cells] for _, card, cells in chosen[-2:]}
    assert added == {"small": [3, 4], "discovery-n3-paper-lambda0-seed0": [3, 4]}
    assert [card.n_agents for _, card, _ in chosen[:-2]] == [3, 3, 4, 4]
    with pytest.raises(InputError, match="no-such-policy"):
        select_policies(["default", "no-such-policy"], ["all"], ["all"])


def test_an_explainer_given_beside_all_is_added() -> None:
    every = explainers_meant(["all"])
    assert "attention" in every
    assert "random" not in every
    assert explainers_meant(["random", "all", "attention", "random"]) == ["random", *every]
    with pytest.raises(InputError, match="no-such-explainer"):
        explainers_meant(["all", "no-such-explainer"])
