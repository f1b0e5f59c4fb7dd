"""A study scores what is missing and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import MakeBundle
from xmarl_bench.entry import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.policy import load_policy
from xmarl_bench.registry import FoundExplainer, find_explainer
from xmarl_bench.request import Cell, Request, Sampling
from xmarl_bench.scoring import score_requests
from xmarl_bench.study import cache as module
from xmarl_bench.study.cache import Cache, code_sha256, content_key

SAMPLING = Sampling(episodes=2, timesteps=2, max_cycles=5)


def request(folder: Path, name: str = "attention", sampling: Sampling = SAMPLING) -> Request:
    policy, card = load_policy(folder)
    return Request(policy, card, find_explainer(name), (Cell(card.task, card.n_agents),), sampling, 0)


class Counted:
    """`score_requests` that says what it was asked for, and stops at a policy if told so."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[str] = []
        self.stop_at: str | None = None
        self.score = score_requests
        monkeypatch.setattr(module, "score_requests", self)

    def __call__(self, requests: Sequence[Request], **options: Any) -> Any:
        for each in requests:
            if each.card.name == self.stop_at:
                raise KeyboardInterrupt
            self.asked.append(f"{each.card.name} {each.explainer.explainer.name}")
        return self.score(requests, **options)


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    return Counted(monkeypatch)


def complete(folder: Path, requests: Sequence[Request]) -> list[Entry]:
    return Cache(folder).complete(requests, submitter=None)


def test_what_is_there_is_not_scored_again(make_bundle: MakeBundle, tmp_path: Path, counted: Counted) -> None:
    one, two = make_bundle(name="one"), make_bundle(name="two", seed=1)
    first = complete(tmp_path / "entries", [request(one), request(two)])
    assert counted.asked == ["one attention", "two attention"]
    assert [entry.policy.name for entry in first] == ["one", "two"]
    more = [request(one), request(one, "attention-rowmax"), request(two)]
    second = complete(tmp_path / "entries", more)
    assert counted.asked[2:] == ["one attention-rowmax"]
    assert [second[0], second[2]] == first
    assert second[1].explainer.name == "attention-rowmax"


def test_a_stopped_run_goes_on_where_it_was(
    make_bundle: MakeBundle, tmp_path: Path, counted: Counted
) -> None:
    requests = [request(make_bundle(name="one")), request(make_bundle(name="two", seed=1))]
    counted.stop_at = "two"
    with pytest.raises(KeyboardInterrupt):
        complete(tmp_path / "entries", requests)
    counted.stop_at = None
    complete(tmp_path / "entries", requests)
    assert counted.asked == ["one attention", "two attention"]


def test_a_damaged_entry_is_scored_again(make_bundle: MakeBundle, tmp_path: Path, counted: Counted) -> None:
    asked = request(make_bundle())
    (whole,) = complete(tmp_path / "entries", [asked])
    path = Cache(tmp_path / "entries").path(asked)
    path.write_text(path.read_text().replace('"fid_plus"', '"fid_less"', 1))
    assert complete(tmp_path / "entries", [asked])[0].entry_id == whole.entry_id
    assert len(counted.asked) == 2


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
        replace(base, cells=(Cell("blind_navigation_v0", 4),)),
        replace(base, behaviour_episodes=1),
    ]
    keys = {content_key(each) for each in [base, *changed]}
    assert len(keys) == 1 + len(changed)
    remarked = replace(base, card=base.card.model_copy(update={"performance": {"measured": "again"}}))
    assert content_key(remarked) == content_key(base)


def test_the_key_follows_an_explainers_code(make_bundle: MakeBundle, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = request(make_bundle())
    assert code_sha256(asked.explainer) is not None
    before = content_key(asked)

    def edited(found: FoundExplainer) -> str:
        return "of other code"

    monkeypatch.setattr(module, "code_sha256", edited)
    assert content_key(asked) != before


def test_the_key_follows_the_code_of_a_file(make_bundle: MakeBundle, tmp_path: Path) -> None:
    base = request(make_bundle())
    file, keys = tmp_path / "mine.py", set()
    for value in ("zeros", "ones"):
        file.write_text(
            "import torch\n\n\ndef mine(observations, policy):\n"
            f"    return torch.{value}(*observations.shape[:2], observations.shape[1])\n"
        )
        keys.add(content_key(replace(base, explainer=find_explainer(f"{file}:mine"))))
    assert len(keys) == 2


def test_an_error_names_the_explainer_and_keeps_what_was_done(
    make_bundle: MakeBundle, tmp_path: Path, counted: Counted
) -> None:
    def broken(*_: object) -> object:
        return None

    one, two = request(make_bundle(name="one")), request(make_bundle(name="two", seed=1))
    bad = replace(two.explainer, explainer=replace(two.explainer.explainer, explain=broken))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="attention"):
        complete(tmp_path / "entries", [one, replace(two, explainer=bad)])
    assert Cache(tmp_path / "entries").read(one) is not None
