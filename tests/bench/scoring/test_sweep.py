"""A sweep computes only missing pieces, and a failure does not stop the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.conftest import MakeBundle
from tests.helpers.example_plugins import BAD
from xmarl_bench.entry import aggregation
from xmarl_bench.entry.aggregation import summarise
from xmarl_bench.entry.metric_records import Summary
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.explain.control_names import INITIAL_ATTENTION
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.metrics.statistics import percentile_interval
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import Policy, load_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.episodes import Rollout
from xmarl_bench.rollout.reference_states import FIRST_FIT_SEED
from xmarl_bench.scoring import pieces
from xmarl_bench.scoring import sweep as module
from xmarl_bench.scoring.cache import Cache
from xmarl_bench.scoring.measure import Unit
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.run_record import run_records
from xmarl_bench.scoring.score import Failed, score_requests
from xmarl_bench.scoring.sweep import Payload, run

pytestmark = pytest.mark.slow

SAMPLING = Sampling(episodes=3, timesteps=2, max_cycles=5)  # two blocks


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "BLOCK", 2)


def request(folder: Path, explainer: Explainer | str = "attention", sampling: Sampling = SAMPLING) -> Request:
    policy, card = load_policy(folder)
    explainer = find_explainer(explainer) if isinstance(explainer, str) else explainer
    return Request(policy, card, explainer, (Cell(card.task, card.n_agents),), sampling, 0)


class Spy:
    """What workers received: rollouts, and groups by the explainers in them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seen: list[str] = []
        play = Rollout.play

        def spied_play(rollout: Rollout) -> object:
            if rollout.seeds[0] != FIRST_FIT_SEED:  # not the reference states, once per policy and run
                self.seen.append(f"play {len(rollout.seeds)}")
            return play(rollout)

        def spied_run(payload: Payload) -> object:
            units = payload.work
            if isinstance(units, tuple):
                unit: Unit = units[0]
                names = [each.name for each in unit.explainers] + ["shared"] * unit.shared
                self.seen.append(f"{' '.join(names)} {len(units)}")
            return run(payload)

        monkeypatch.setattr(Rollout, "play", spied_play)
        monkeypatch.setattr(module, "run", spied_run)

    def take(self) -> list[str]:
        seen, self.seen = self.seen, []
        return seen


PLAYED = ["play 2", "play 1"] * 2  # with messages, and without


@pytest.fixture
def spy(monkeypatch: pytest.MonkeyPatch) -> Spy:
    return Spy(monkeypatch)


def outcomes(folder: Path, requests: Sequence[Request], **options: bool) -> list[Entry | Failed]:
    return list(score_requests(requests, cache=Cache(folder), **options))  # type: ignore[arg-type]


def ids(found: Sequence[Entry | Failed]) -> list[str]:
    return [each.entry_id for each in found if isinstance(each, Entry)]


def test_cards_of_the_same_weights_have_their_own_controls(make_bundle: MakeBundle, tmp_path: Path) -> None:
    """The attention of the weights before training, of the card that says how they were drawn."""
    first = request(make_bundle(name="one"))
    cards = [first.card.model_copy(update={"name": n, "initial_seed": s}) for n, s in (("a", 3), ("b", None))]
    for _ in range(2):  # computed, and from the cache
        found = outcomes(tmp_path / "cache", [replace(first, card=card) for card in cards])
        controls = [each.results[0].controls for each in found if isinstance(each, Entry)]
        assert [INITIAL_ATTENTION in each for each in controls] == [True, False]


def test_cached_pieces_are_not_computed_again(make_bundle: MakeBundle, tmp_path: Path, spy: Spy) -> None:
    one, cache = make_bundle(name="one"), tmp_path / "cache"
    first = outcomes(cache, [request(one)])
    assert spy.take() == [*PLAYED, "attention shared 2", "attention shared 1"]
    second = outcomes(cache, [request(one), request(one, "attention-rowmax")])
    assert spy.take() == ["attention-rowmax 2", "attention-rowmax 1"]
    assert ids(second[:1]) == ids(first)
    longer = replace(SAMPLING, episodes=5)
    outcomes(cache, [request(one, sampling=longer)])
    assert spy.take() == [*PLAYED, "attention shared 2", "attention shared 1"]
    assert ids(outcomes(cache, [request(one)], fresh=True)) == ids(first)
    assert spy.take() == [*PLAYED, "attention shared 2", "attention shared 1"]


def test_a_damaged_result_is_computed_again(make_bundle: MakeBundle, tmp_path: Path, spy: Spy) -> None:
    asked, cache = request(make_bundle()), Cache(tmp_path / "cache")
    (whole,) = outcomes(cache.folder, [asked])
    assert isinstance(whole, Entry)
    spy.take()
    files = sorted(path for path in cache.folder.glob("*/??/*"))
    assert len(files) == 8  # two of each kind
    for path in files:
        path.write_bytes(path.read_bytes()[:-1])
    (again,) = outcomes(cache.folder, [asked])
    assert isinstance(again, Entry)
    assert again.entry_id == whole.entry_id
    assert len(spy.take()) == 6


def test_a_result_of_other_episodes_under_a_right_digest_is_computed_anew_and_said(
    make_bundle: MakeBundle, tmp_path: Path, spy: Spy, capsys: pytest.CaptureFixture[str]
) -> None:
    asked, cache = request(make_bundle()), Cache(tmp_path / "cache")
    (whole,) = outcomes(cache.folder, [asked])
    spy.take()
    files = sorted(cache.folder.glob("*/??/*"))
    for wrong in (b"[]", b"[[]]", b"{"):  # the first is a result of no episodes
        for path in files:
            cache.write(path.parent.parent.name + path.name, wrong)
        assert ids(outcomes(cache.folder, [asked])) == ids([whole])
        said = capsys.readouterr().err
        assert said.count("does not hold the result of") == len(files)
        assert all(f"{path} does not hold" in said for path in files)
        assert len(spy.take()) == 6


def test_an_entry_is_made_when_its_pieces_are_finished(
    make_bundle: MakeBundle, tmp_path: Path, spy: Spy
) -> None:
    folder = make_bundle()
    slow = replace(find_explainer("occlusion"), slow=True)
    requests = [request(folder, slow), request(folder)]
    found = outcomes(tmp_path / "one", requests, in_order=False)
    groups = ["attention shared 2", "attention shared 1", "occlusion 2", "occlusion 1"]
    assert spy.take() == [*PLAYED, *groups]
    assert [each.explainer.name for each in found if isinstance(each, Entry)] == ["attention", "occlusion"]
    assert ids(outcomes(tmp_path / "two", requests)) == ids(found)[::-1]


def picky(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """Works only for teams of three."""
    if observations.shape[1] != 3:
        raise ValueError("three, please")
    return torch.ones(*observations.shape[:2], observations.shape[1])


PICKY = Explainer("picky", picky)


def test_a_failure_does_not_stop_others_and_is_retried(
    make_bundle: MakeBundle, tmp_path: Path, spy: Spy
) -> None:
    three, four = make_bundle(name="three"), make_bundle(name="four", n_agents=4)
    requests = [request(folder, found) for folder in (four, three) for found in (PICKY, "attention")]
    first = outcomes(tmp_path / "cache", requests)
    failed, *others = first
    assert spy.take()[8:10] == [
        "attention shared 2",
        "attention shared 1",
    ]  # not picky's, which ran before
    assert isinstance(failed, Failed)
    assert "'picky' failed" in failed.error
    assert "three, please" in failed.error
    assert str(failed).startswith("picky on four: ")
    assert [type(each) for each in others] == [Entry] * 3
    again = outcomes(tmp_path / "cache", requests)
    assert ids(again[1:]) == ids(others)
    assert isinstance(again[0], Failed)
    assert spy.take() == ["picky 2", "picky 1"]


def test_explainers_that_all_fail_everywhere_are_refused_before_explaining(
    make_bundle: MakeBundle, tmp_path: Path, spy: Spy
) -> None:
    folder, cache = make_bundle(), tmp_path / "cache"
    with pytest.raises(InputError, match="'nan'"):
        outcomes(cache, [request(folder, BAD["nan"]), request(folder, BAD["crash"])])
    assert spy.take() == PLAYED
    found = outcomes(cache, [request(folder), request(folder, BAD["nan"])])
    assert [type(each) for each in found] == [Entry, Failed]
    assert spy.take() == ["attention shared 2", "attention shared 1"]


def test_the_failing_explainer_of_a_group_is_named(
    make_bundle: MakeBundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when memory runs out, which a single explainer cannot be tested for."""

    def out_of_memory(payload: Payload) -> object:
        units = payload.work
        if isinstance(units, tuple) and any(each.name == "occlusion" for each in units[0].explainers):
            raise MemoryError("no more")
        return run(payload)

    monkeypatch.setattr(module, "run", out_of_memory)
    folder = make_bundle()
    found = outcomes(tmp_path / "cache", [request(folder, name) for name in ("occlusion", "attention")])
    assert isinstance(found[0], Failed)
    assert found[0].error == "MemoryError: no more"
    assert isinstance(found[1], Entry)
    failures = [path.read_text() for path in (tmp_path / "cache").glob("*/??/*.failed")]
    assert len(failures) == 2
    assert all("MemoryError: no more" in text and "Traceback" in text for text in failures)
    monkeypatch.setattr(module, "run", run)
    assert all(
        isinstance(each, Entry) for each in outcomes(tmp_path / "cache", [request(folder, "occlusion")])
    )
    assert not list((tmp_path / "cache").glob("*/??/*.failed"))


def test_the_record_of_a_run_has_its_progress(make_bundle: MakeBundle, tmp_path: Path) -> None:
    cache, out = Cache(tmp_path / "cache"), tmp_path / "out"
    three, four = make_bundle(name="three"), make_bundle(name="four", n_agents=4)
    requests = [request(three), request(four, PICKY), request(three, PICKY)]
    out.mkdir()
    results = score_requests(requests, cache=cache, out=out)
    next(results)
    (record,) = run_records(cache)
    progress = record.progress(cache)
    assert progress.running
    assert progress.entries == 1
    assert progress.explainers["attention"] == (2, 2)
    list(results)
    progress = record.progress(cache)
    assert (progress.done, progress.pieces, progress.entries) == (16, 18, 2)
    assert {text.splitlines()[0] for text in progress.failures.values()} != set()


def by_median(values: Sequence[float | None], rng: np.random.Generator) -> Summary:
    known = [value for value in values if value is not None]
    median = float(np.median(known)) if known else None
    return summarise(values, rng).model_copy(update={"value": median})


AGGREGATIONS = {"percentile_interval": partial(percentile_interval, confidence=0.5), "summarise": by_median}


def test_a_change_of_the_aggregation_takes_effect_with_cached_pieces(
    make_bundle: MakeBundle, tmp_path: Path, spy: Spy, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, cache = make_bundle(), tmp_path / "cache"

    def interval() -> tuple[float | None, object]:
        (entry,) = outcomes(cache, [request(folder)])
        assert isinstance(entry, Entry)
        fid_plus = entry.results[0].metrics.fid_plus
        assert fid_plus is not None
        return fid_plus.value, fid_plus.interval

    first = interval()
    spy.take()
    assert interval() == first
    for name, other in AGGREGATIONS.items():
        with monkeypatch.context() as patch:
            patch.setattr(aggregation, name, other)
            assert interval() != first, name
    assert spy.take() == []


def test_episodes_are_read_from_the_cache_once_per_run(
    make_bundle: MakeBundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[str] = []
    read = Cache.read

    def spied_read(cache: Cache, key: str) -> bytes | None:
        reads.append(key)
        return read(cache, key)

    monkeypatch.setattr(Cache, "read", spied_read)
    folder = make_bundle()
    for _ in range(2):
        outcomes(tmp_path / "cache", [request(folder, name) for name in ("attention", "occlusion")])
        assert len(reads) == len(set(reads)) == 10  # 2 blocks: two rollouts, shared, two explainers
        reads.clear()
