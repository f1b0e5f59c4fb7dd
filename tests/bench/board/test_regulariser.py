"""Pairs of training runs with and without the attention-entropy term, on boards made by hand."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from tests.helpers.made_entries import made_entry
from xmarl_bench.board import board_of
from xmarl_bench.board.answer import answer_on_term
from xmarl_bench.board.regulariser import families_of, regulariser_of, score_of, values_of

pytestmark = pytest.mark.slow
# Message fidelity without and with the term, by family and training seed.
RUNS = {
    (3, False): {0: (0.5, 0.7), 1: (0.6, 0.7), 2: (0.4, 0.7)},
    (3, True): {0: (0.8, 0.7), 1: (0.9, 1.0), 2: (0.7, 0.9)},
    (5, False): {0: (0.2, 0.3), 2: (0.1, 0.3)},
}


def policy(
    n_agents: int, residual: bool, seed: int | None, term: float, level: float, **options: Any
) -> tuple[str, Any]:
    name = f"n{n_agents}-{'residual' if residual else 'paper'}-lambda{term}-seed{seed}".lower()
    entry = made_entry(name, "attention", 0.5, n_agents=n_agents, residual=residual, training_seed=seed,
                       attention_entropy=term, message_fidelity=level, **options)  # fmt: skip
    return f"{name}.json", entry


@cache
def runs() -> tuple[tuple[str, Any], ...]:
    return tuple(
        policy(n, residual, seed, term, level)
        for (n, residual), seeds in RUNS.items()
        for seed, ends in seeds.items()
        for term, level in zip((0.0, 0.1), ends, strict=True)
    )


def paired(*others: tuple[str, Any]) -> list[Any]:
    return families_of(board_of([*runs(), *others])["tables"])


def test_three_seeds_are_three_pairs() -> None:
    """By hand: differences are .2 .1 .3 -.1 .1 .2 in one cell and .1 .2 in another, with means 2/15 and .15.

    Weights are 1/12 and 1/4, their squares sum to 1/6 and their cubes to 5/144; the squares of the weighted
    deviations sum to 7/7200. The squared error is 7/7200 x 4/3, with 5 degrees of freedom.
    """
    families = paired()
    attention = partial(score_of, explainer="attention")
    pairs = values_of(families, attention)
    assert [(family["n_agents"], family["kind"]) for family, *_ in pairs] == [
        (n, "residual" if residual else "paper") for (n, residual), seeds in RUNS.items() for _ in seeds
    ]
    ends = [each for seeds in RUNS.values() for each in seeds.values()]
    assert np.array([each for _, *each in pairs]) == pytest.approx(np.array(ends))
    found = regulariser_of(families)["attention"]
    assert found["n"] == 8
    assert (found["without"], found["with"]) == pytest.approx((0.4, 13 / 24))
    assert found["difference"] == pytest.approx(17 / 120)
    half = 2.570582 * (7 / 5400) ** 0.5  # Student's t of 5 degrees of freedom
    assert found["interval"] == pytest.approx([17 / 120 - half, 17 / 120 + half], abs=1e-5)
    assert answer_on_term("attention", found).endswith("(0.049 to 0.234), over 8 pairs of training runs.")


def test_runs_without_a_partner_change_nothing() -> None:
    others = [
        policy(5, False, 1, 0.1, 0.9),  # seed 1 has no run without the term
        policy(5, True, 0, 0.1, 0.9),  # another architecture
        policy(4, False, 0, 0.1, 0.9),  # another team size
        policy(5, False, None, 0.0, 0.9),  # nobody knows its seed
        policy(5, False, None, 0.1, 0.9),
        policy(5, False, 0, 0.2, 0.9, success_rate=0.2),  # its explanations are not ranked
        policy(8, False, 0, 0.0, 0.9, trained=5),  # in a larger team
        policy(8, False, 0, 0.1, 0.9, trained=5),
    ]
    families = paired(*others)
    assert regulariser_of(families) == regulariser_of(paired())
    assert [len(family["pairs"]) for family in families] == [len(seeds) for seeds in RUNS.values()]


def test_weights_of_the_term_are_averaged_within_a_pair() -> None:
    *_, pair, _ = values_of(paired(policy(5, False, 0, 0.5, 0.7)), partial(score_of, explainer="attention"))
    assert pair[1:] == pytest.approx((0.2, 0.5))
