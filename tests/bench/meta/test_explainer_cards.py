"""Cards of explainers: the paper is the one that their module names, planted truth is that of the suite."""

from __future__ import annotations

import pytest

from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.meta.explainer_cards import cards_of, paper_of
from xmarl_bench.plugins.registry import find_explainer


@pytest.mark.parametrize(
    ("name", "paper"),
    [
        ("gnn_explainer", "Ying et al., \"GNNExplainer: Generating Explanations for Graph Neural Networks\" "
         "(NeurIPS 2019)"),
        ("gnn_explainer-tuned", "see `gnn_explainer`"),
        ("attention-rowmax", None),
    ],
)  # fmt: skip
def test_papers_are_those_of_the_modules(name: str, paper: str | None) -> None:
    assert paper_of(find_explainer(name)) == paper


def test_an_object_without_origin_has_no_paper() -> None:
    made = Explainer("made", find_explainer("attention").explain)
    assert paper_of(made) is None


@pytest.mark.slow
def test_attention_fails_with_the_decoy_alone() -> None:
    cards = cards_of([find_explainer("attention"), find_explainer("random")], sizes=(4,), n_steps=20)
    assert set(cards) == {"attention"}  # a control has no card
    assert cards["attention"]["absence"] is None
    planted = cards["attention"]["planted"]
    assert planted["decoy"] < 0.9 < min(value for family, value in planted.items() if family != "decoy")
