"""Work that would come out the same has one name, and work that would not another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.conftest import MakeBundle
from xmarl_bench.plugins.registry import FoundExplainer, find_explainer
from xmarl_bench.policy import load_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring import content_key as module
from xmarl_bench.scoring.content_key import code_sha256
from xmarl_bench.scoring.pieces import Plan
from xmarl_bench.scoring.request import Request

SAMPLING = Sampling(episodes=12, timesteps=2, max_cycles=5)


def request(folder: Path, name: str = "attention", sampling: Sampling = SAMPLING) -> Request:
    policy, card = load_policy(folder)
    return Request(policy, card, find_explainer(name), (Cell(card.task, card.n_agents),), sampling, 1)


def plan(asked: Request, submitter: str | None = None) -> Plan:
    return Plan.of(asked, submitter)


def test_the_key_follows_what_numbers_depend_on(make_bundle: MakeBundle) -> None:
    base = request(make_bundle())
    found = base.explainer
    retuned = replace(found, explainer=replace(found.explainer, hyperparameters={"lr": 0.1}))
    changed = [
        request(make_bundle(seed=1)),
        replace(base, explainer=retuned),
        replace(base, explainer=replace(found, version="99")),
        replace(base, sampling=replace(SAMPLING, timesteps=3)),
        replace(base, sampling=replace(SAMPLING, seed=1)),
        replace(base, sampling=replace(SAMPLING, max_cycles=4)),
        replace(base, cells=(Cell("blind_navigation_v0", 4),)),
    ]
    explained = {plan(each).needs[0].explained[0].key for each in [base, *changed]}
    assert len(explained) == 1 + len(changed)
    entries = {plan(each).key for each in [base, *changed, replace(base, behaviour_episodes=2)]}
    assert len(entries) == 2 + len(changed)
    assert plan(base, "somebody").key not in entries
    remarked = replace(base, card=base.card.model_copy(update={"performance": {"measured": "again"}}))
    assert plan(remarked).key == plan(base).key


def test_pieces_are_shared_by_all_that_need_the_same(make_bundle: MakeBundle) -> None:
    one, other = (plan(request(make_bundle(), name)).needs[0] for name in ("attention", "occlusion"))
    assert [piece.block.first for piece in one.episodes] == [0, 10]
    assert [len(piece.block.seeds) for piece in one.episodes] == [10, 2]
    assert [piece.source for piece in one.explained] == list(one.episodes)
    assert (one.episodes, one.shared, one.random_behaviour) == (
        other.episodes, other.shared, other.random_behaviour,
    )  # fmt: skip
    assert not {piece.key for piece in one.explained} & {piece.key for piece in other.explained}
    renamed = plan(request(make_bundle(name="another"))).needs[0]
    assert [piece.key for piece in renamed] == [piece.key for piece in one]  # the weights are the same


def test_the_key_follows_an_explainers_code(make_bundle: MakeBundle, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = request(make_bundle())
    assert code_sha256(asked.explainer) is not None
    before = plan(asked).key

    def edited(found: FoundExplainer) -> str:
        return "of other code"

    monkeypatch.setattr(module, "code_sha256", edited)
    assert plan(asked).key != before


def test_the_key_follows_the_code_of_a_file(make_bundle: MakeBundle, tmp_path: Path) -> None:
    base = request(make_bundle())
    file, keys = tmp_path / "mine.py", set()
    for value in ("zeros", "ones"):
        file.write_text(
            "import torch\n\n\ndef mine(observations, policy):\n"
            f"    return torch.{value}(*observations.shape[:2], observations.shape[1])\n"
        )
        keys.add(plan(replace(base, explainer=find_explainer(f"{file}:mine"))).key)
    assert len(keys) == 2
