"""Pieces with the same result have the same key; others have different keys."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from pathlib import Path

import pytest

from tests.conftest import MakeBundle
from xmarl_bench.explain.adapters import origin_of_explainer
from xmarl_bench.origin.code_hash import harness_sources, sources_sha256
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import load_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring import piece_keys as module
from xmarl_bench.scoring.piece_keys import Keys, version_key
from xmarl_bench.scoring.pieces import Plan
from xmarl_bench.scoring.request import Request

SAMPLING = Sampling(episodes=12, timesteps=2, max_cycles=5)


def request(folder: Path, name: str = "attention", sampling: Sampling = SAMPLING) -> Request:
    policy, card = load_policy(folder)
    return Request(policy, card, find_explainer(name), (Cell(card.task, card.n_agents),), sampling, 1)


def plan(asked: Request) -> Plan:
    return Plan.of(asked, Keys())


def test_the_key_changes_with_everything_that_numbers_depend_on(make_bundle: MakeBundle) -> None:
    base = request(make_bundle())
    explainer = base.explainer
    newer = replace(explainer, origin=replace(origin_of_explainer(explainer), version="99"))
    changed = [
        request(make_bundle(seed=1)),
        replace(base, explainer=replace(explainer, hyperparameters={"lr": 0.1})),
        replace(base, explainer=newer),
        replace(base, sampling=replace(SAMPLING, timesteps=3)),
        replace(base, sampling=replace(SAMPLING, seed=1)),
        replace(base, sampling=replace(SAMPLING, max_cycles=4)),
        replace(base, cells=(Cell("blind_navigation_v0", 4),)),
    ]
    explained = {plan(each).needs[0].explained[0].key for each in [base, *changed]}
    assert len(explained) == 1 + len(changed)
    retold = replace(base, explainer=replace(explainer, summary="said in other words"))
    remarked = replace(base, card=base.card.model_copy(update={"performance": {"measured": "again"}}))
    for same in (retold, remarked):
        assert plan(same).piece_keys == plan(base).piece_keys


@pytest.mark.slow
def test_requests_share_equal_pieces(make_bundle: MakeBundle) -> None:
    one, other = (plan(request(make_bundle(), name)).needs[0] for name in ("attention", "occlusion"))
    assert [piece.block.first for piece in one.episodes] == [0, 10]
    assert [len(piece.block.seeds) for piece in one.episodes] == [10, 2]
    assert [piece.source for piece in one.explained] == list(one.episodes)
    assert (one.episodes, one.shared, one.random_behaviour) == (
        other.episodes, other.shared, other.random_behaviour,
    )  # fmt: skip
    assert not {piece.key for piece in one.explained} & {piece.key for piece in other.explained}
    renamed = plan(request(make_bundle(name="another"))).needs[0]
    assert [piece.key for piece in chain(*renamed)] == [piece.key for piece in chain(*one)]  # same weights


def test_the_key_changes_with_every_source_and_version(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Even an unused colour constant gives a new version, for which everything is computed once."""
    sources = dict(harness_sources())
    assert {"xmarl_envs/colours.py", "xmarl_bench/entry/aggregation.py"} <= sources.keys()
    before = sources_sha256(sources.items())
    edited = tmp_path / "colours.py"
    edited.write_bytes(sources["xmarl_envs/colours.py"].read_bytes() + b"UNUSED = (1, 2, 3)\n")
    after = {sources_sha256({**sources, "xmarl_envs/colours.py": edited}.items()) for _ in range(2)}
    assert len(after) == 1
    assert before not in after
    keys = {version_key()}
    with monkeypatch.context() as patch:
        patch.setattr(module, "sources_sha256", lambda _: after.copy().pop())
        keys.add(version_key.__wrapped__())
    monkeypatch.setattr(module, "package_version", lambda name: f"{name} of tomorrow")
    keys.add(version_key.__wrapped__())
    assert len(keys) == 3
