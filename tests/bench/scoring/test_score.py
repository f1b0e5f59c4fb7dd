"""Entries repeat byte for byte, for any number of parallel episodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from xmarl_envs import TASKS

from tests.conftest import MakeBundle
from tests.helpers.example_plugins import BAD, slow
from xmarl_bench.entry.file import write_entry
from xmarl_bench.entry.metric_records import BehaviourMetrics
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.metrics.table import UNDER_ABSENCES
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import Architecture, GraphPolicy, Policy, load_policy
from xmarl_bench.records.files import canonical_json
from xmarl_bench.reproducible import PUBLIC_SEEDS, derived_seed, episode_seeds
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.evaluation import evaluate
from xmarl_bench.scoring.request import Request, plan
from xmarl_bench.scoring.score import entries_of, score, score_requests
from xmarl_bench.submission.consistency import entry_findings
from xmarl_bench.submission.rounding import CLOSE


def bytes_of(entry: Entry) -> bytes:
    """An entry without provenance and cost."""
    return canonical_json(entry.model_dump(mode="json", exclude={"provenance", "cost"}))


@pytest.mark.slow
@pytest.mark.parametrize("task", sorted(TASKS))
def test_two_runs_and_any_parallel_episodes_write_the_same_bytes(task: str, make_bundle: MakeBundle) -> None:
    folder = make_bundle(task)
    runs = [
        score(folder, "random", episodes=3, max_cycles=8, parallel_episodes=width) for width in (50, 1, 2)
    ]
    assert len({bytes_of(entry) for entry in runs}) == 1
    assert runs[0].results[0].episodes[0].timesteps == 8


@pytest.mark.slow
def test_an_entry_does_not_depend_on_other_requests(make_bundle: MakeBundle) -> None:
    policy, card = load_policy(make_bundle())
    samplings = Sampling(episodes=3, max_cycles=8), Sampling(episodes=2, timesteps=3, max_cycles=8)
    names = ("random", "attention")
    requests = [
        Request(policy, card, find_explainer(name), (Cell(card.task, 3),), sampling)
        for name in names
        for sampling in samplings
    ]
    together = {bytes_of(entry) for entry in entries_of(score_requests(requests))}
    apart = {
        bytes_of(entry) for request in reversed(requests) for entry in entries_of(score_requests([request]))
    }
    assert together == apart
    assert len(together) == 4


@pytest.mark.slow
def test_another_seed_gives_another_score(make_bundle: MakeBundle) -> None:
    folder = make_bundle()
    first, second = (score(folder, "attention", episodes=2, max_cycles=10, seed=seed) for seed in (0, 1))
    assert first.results[0].metrics.fid_plus != second.results[0].metrics.fid_plus
    assert not set(first.protocol.seeds) & set(second.protocol.seeds)


@pytest.mark.slow
def test_the_fields_of_an_entry(make_bundle: MakeBundle) -> None:
    entry = score(make_bundle("blind_passage_v0"), "all-ones", episodes=3, timesteps=4, max_cycles=12)
    (cell,) = entry.results
    assert (cell.task, cell.n_agents, cell.max_cycles) == ("blind_passage_v0", 3, 12)
    assert [row.seed for row in cell.episodes] == list(entry.protocol.seeds) == episode_seeds(0, 3)
    assert [row.timesteps for row in cell.episodes] == [4, 4, 4]
    assert cell.metrics.no_object_collision is not None
    assert cell.metrics.gef is not None
    assert cell.metrics.fid_minus.value == cell.metrics.gef.value == 0.0
    assert cell.metrics.fid_minus.interval == (0.0, 0.0)
    assert cell.metrics.mask_mass.value == 1.0
    assert (cell.metrics.reward.n, cell.metrics.reward.n_nan) == (3, 0)
    assert entry.explainer.control
    assert entry.cost.explained_timesteps == 12
    assert entry.policy.attention_entropy == 0.5
    assert entry.provenance.packages["torch"] == version("torch")


@pytest.mark.slow
def test_every_entry_carries_the_controls_on_the_same_states(make_bundle: MakeBundle) -> None:
    folder = make_bundle()
    entry, ones = (score(folder, name, episodes=2, max_cycles=9) for name in ("attention", "all-ones"))
    (cell,), (own,) = entry.results, ones.results
    assert set(cell.controls) == {
        *CONTROLS,
        "nearest",
        "inverted",
    }  # the card has no seed of the initial weights
    for name, summary in cell.controls["all-ones"]:
        if name not in BehaviourMetrics.model_fields:
            other = getattr(own.metrics, name)  # whose rows were rounded before their mean
            assert summary.value == pytest.approx(other.value, rel=CLOSE, abs=CLOSE, nan_ok=True), name
            assert summary.interval == pytest.approx(other.interval, rel=CLOSE, abs=CLOSE), name
            assert (summary.n, summary.n_nan) == (other.n, other.n_nan), name
    assert cell.controls["all-ones"].fid_minus.value == 0.0
    oracle, soft = (cell.controls[name].fid_delta.value for name in ("oracle", "soft-oracle"))
    assert oracle is not None
    assert soft is not None
    for name, control in cell.controls.items():
        assert (control.fid_delta.value or 0.0) <= soft + 1e-6, name
    for name in ("all-ones", "zeros", "bernoulli", "self"):
        assert (cell.controls[name].fid_delta.value or 0.0) <= oracle + 1e-6, name
    inverse = -(cell.metrics.fid_delta.value or 0.0)
    assert cell.controls["inverted"].fid_delta.value == pytest.approx(inverse, abs=1e-7)


@pytest.mark.slow
def test_metrics_that_are_not_measured_have_a_reason(make_bundle: MakeBundle) -> None:
    policy, card = load_policy(make_bundle())

    def reasons(name: str, n_agents: int, behaviour_episodes: int | None) -> dict[str, str]:
        cell = Cell(card.task, n_agents)
        sampling = Sampling(episodes=1, timesteps=1, max_cycles=2)
        request = Request(policy, card, find_explainer(name), (cell,), sampling, behaviour_episodes)
        (entry,) = entries_of(score_requests([request]))
        (result,) = entry.results
        nulls = {name for name, summary in result.metrics if summary is None}
        assert nulls == set(result.not_measured)
        return result.not_measured

    behaviour = set(BehaviourMetrics.model_fields)
    assert set(reasons("attention", 3, None)) == {"seed_stability", "no_object_collision"}
    assert set(reasons("random", 3, 0)) == {"no_object_collision"} | behaviour
    assert "at every step" in reasons("random", 3, 0)["behavioural_fidelity"]
    two = reasons("random", 2, None)
    assert set(two) == {
        "no_object_collision", "comm_topk_fid_delta", *UNDER_ABSENCES, "message_fidelity",
        "smallest_message_fidelity", *behaviour
    }  # fmt: skip
    assert "needs 3 agents" in two["comm_budgeted_fidelity"]
    many = reasons("random", 33, 0)
    assert {name for name in many if "at most 32 agents with one layer, got 33" in many[name]} == {
        "budgeted_fidelity", *UNDER_ABSENCES, "message_fidelity", "smallest_message_fidelity",
    }  # fmt: skip


class Doubled(GraphPolicy):
    """Its coefficients sum to 2 in some states, as those of a layer that adds up two heads."""

    where: Callable[[Tensor], Tensor]  # (S, N, D) -> (S,), 1 or 2

    def attention(self, observation: Tensor) -> Tensor:
        return super().attention(observation) * self.where(observation)[:, None, None]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "measured"),
    [
        (lambda x: torch.full((len(x),), 2.0), [False, False]),
        (lambda x: 1.0 + (x[:, 0, 2:4].abs().sum(dim=-1) > 0), [False, False]),  # but the first step, at rest
        (lambda x: 1.0 + (x[:, 0, 1] > 0), [True, False]),  # the second episode starts there
    ],
    ids=["everywhere", "in motion", "in one episode"],
)
def test_attention_that_does_not_sum_to_1_has_no_entropy(
    where: Callable[[Tensor], Tensor], measured: list[bool], make_bundle: MakeBundle
) -> None:
    policy, card = load_policy(make_bundle())
    assert isinstance(policy.architecture, Architecture)
    doubled = Doubled(policy.architecture).eval()
    doubled.load_state_dict(policy.state_dict())
    doubled.where = where
    sampling, cells = Sampling(2, max_cycles=3), (Cell(card.task, 3),)
    request = Request(doubled, card, find_explainer("random"), cells, sampling, 0)
    (entry,) = entries_of(score_requests([request]))
    (result,) = entry.results
    for name in ("attention_entropy", "attention_distance"):
        assert [getattr(row, name) is not None for row in result.episodes] == measured
        assert (name in result.not_measured) is not any(measured)
    assert not [finding for finding in entry_findings(entry) if "attention_" in finding]
    (performance,) = evaluate([(doubled, cells[0])], sampling)
    assert (performance.attention_entropy is not None) is any(measured)


@pytest.mark.slow
def test_fewer_behaviour_episodes_are_the_first_ones_of_more(make_bundle: MakeBundle) -> None:
    policy, card = load_policy(make_bundle())
    cells, sampling = (Cell(card.task, 3),), Sampling(episodes=4, max_cycles=6)
    requests = [
        Request(policy, card, find_explainer(name), cells, sampling, played)
        for name in ("attention", "bernoulli")
        for played in (4, 2, 0)
    ]
    for entry, request in zip(entries_of(score_requests(requests)), requests, strict=True):
        (cell,) = entry.results
        n_played = request.behaviours(cells[0])
        assert cell.behaviour_episodes == n_played
        played = [row.reward_on_explanation is not None for row in cell.episodes]
        assert played == [k < n_played for k in range(4)]
        for metrics in (cell.metrics, cell.controls["random"]):
            summary = metrics.reward_on_complement
            assert (summary.n, summary.n_nan) == (n_played, 0) if summary else n_played == 0
    whole, half = (entry.results[0].episodes[:2] for entry in entries_of(score_requests(requests[:2])))
    assert whole == half


def test_two_explainers_of_one_name_are_refused(make_bundle: MakeBundle) -> None:
    policy, card = load_policy(make_bundle())
    requests = [
        Request(policy, card, replace(slow, summary=text), (Cell(card.task, 3),), Sampling(1))
        for text in ("one", "another")
    ]
    with pytest.raises(InputError, match="two explainers are named 'slow'"):
        next(entries_of(score_requests(requests)))


@pytest.mark.slow
def test_tasks_without_walls_have_no_object_collision(make_bundle: MakeBundle) -> None:
    entry = score(make_bundle(), "all-ones", episodes=1, max_cycles=5)
    assert entry.results[0].metrics.no_object_collision is None
    assert entry.results[0].metrics.reward.interval is None  # one episode has no interval


@pytest.mark.slow
def test_a_policy_is_scored_with_any_team_size_of_its_task(make_bundle: MakeBundle) -> None:
    folder = make_bundle("blind_passage_v0")
    assert score(folder, "attention", n_agents=5, episodes=1, max_cycles=5).results[0].n_agents == 5
    with pytest.raises(InputError, match="1 to 5 agents, got 6"):
        score(folder, "attention", n_agents=6)


@pytest.mark.slow
def test_an_explainer_that_becomes_invalid_yields_no_entry(make_bundle: MakeBundle) -> None:
    """Every kind of invalid mask: tests/bench/explain/test_explainer.py."""
    with pytest.raises(InputError, match="'late-nan'"):
        score(make_bundle(), BAD["late-nan"], episodes=2, max_cycles=10)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"episodes": 0}, "episodes"),
        ({"seed": -1}, "seed"),
        ({"timesteps": 0}, "timesteps"),
        ({"max_cycles": 0}, "max_cycles"),
        ({"jobs": 0}, "jobs"),
        ({"parallel_episodes": 0}, "parallel_episodes"),
        ({"behaviour_episodes": -1}, "behaviour_episodes"),
        ({"task": "blind_passage_v0"}, "observations of 6 entries"),
        ({"task": "nowhere_v0"}, "unknown task 'nowhere_v0'"),
        ({"n_agents": 0}, "got 0"),
        ({"submitter": "@me"}, "submitter '@me' is not a name in one line"),
        ({"submitter": "x" * 10_001}, "at most 10000 characters: give another name"),
        ({"episodes": 2.0}, "episodes must be a whole number, got 2.0"),
        ({"seed": "0"}, "seed must be a whole number, got '0'"),
        ({"timesteps": 2.5}, "timesteps must be a whole number"),
        ({"max_cycles": 2.5}, "max_cycles must be a whole number"),
        ({"jobs": 1.5}, "jobs must be a whole number"),
        ({"parallel_episodes": 1.5}, "parallel_episodes must be a whole number"),
        ({"behaviour_episodes": 0.5}, "behaviour_episodes must be a whole number"),
        ({"n_agents": 2.5}, "n_agents must be a whole number"),
    ],
)
def test_options_out_of_range_are_refused(
    options: dict[str, float | str], said: str, make_bundle: MakeBundle
) -> None:
    with pytest.raises(InputError, match=said):
        score(make_bundle(), "attention", **options)  # type: ignore[arg-type]


@pytest.mark.slow
def test_whole_numbers_of_numpy_are_numbers(make_bundle: MakeBundle) -> None:
    numbers = {
        "n_agents": 2,
        "episodes": 1,
        "timesteps": 2,
        "max_cycles": 5,
        "behaviour_episodes": 0,
        "seed": 1,
    }
    of_numpy = {name: np.int64(number) for name, number in numbers.items()}
    entries = [score(make_bundle(), "random", **given) for given in (numbers, of_numpy)]
    assert bytes_of(entries[0]) == bytes_of(entries[1])


def test_other_objects_than_policies_are_refused(make_bundle: MakeBundle) -> None:
    network, _ = load_policy(make_bundle())
    for policy in (network, None, ("a", "b"), (network,)):
        with pytest.raises(InputError, match="is not a policy to score: give"):
            score(policy, "attention")  # type: ignore[arg-type]


@pytest.mark.slow
def test_weights_that_changed_after_loading_are_other_weights(
    tmp_path: Path, make_bundle: MakeBundle
) -> None:
    loaded, card = load_policy(make_bundle())
    changed, _ = load_policy(make_bundle())
    with torch.no_grad():
        next(changed.parameters()).zero_()

    def scored(network: Policy, cache: Path | None) -> Entry:
        few = {"episodes": 1, "timesteps": 3, "max_cycles": 8, "behaviour_episodes": 0}
        return score((network, card), "attention", cache=cache, **few)  # type: ignore[arg-type]

    as_loaded = scored(loaded, tmp_path)
    assert as_loaded.policy.weights_sha256 == card.weights_sha256
    entry = scored(changed, tmp_path)
    assert entry.policy.weights_sha256 != card.weights_sha256
    assert bytes_of(entry) == bytes_of(scored(changed, None))
    assert entry.results[0].metrics != as_loaded.results[0].metrics


def test_slow_explainers_get_few_states_and_others_also_all(make_bundle: MakeBundle) -> None:
    policy, card = load_policy(make_bundle())
    selected = [(policy, card, (Cell(card.task, 3),))]
    explainers = [find_explainer("random"), find_explainer("attention"), slow]
    full, few = Sampling(episodes=50), Sampling(episodes=5, timesteps=20)
    planned = [(each.explainer.name, each.sampling) for each in plan(selected, explainers, full, few)]
    assert planned == [
        ("random", full), ("random", few), ("attention", full), ("attention", few), ("slow", few),
    ]  # fmt: skip
    assert {each.sampling for each in plan(selected, explainers[:2], full, few)} == {full}
    assert {each.sampling for each in plan(selected, explainers, full)} == {full}


@pytest.mark.slow
def test_seeds_are_far_from_those_of_training_and_never_shared() -> None:
    assert episode_seeds(0, 3) == list(PUBLIC_SEEDS[:3])
    assert min(episode_seeds(0, 1)) > 2**31
    assert max(episode_seeds(10**9 - 1, 10**6)) < 2**53
    assert episode_seeds(1, 1)[0] == episode_seeds(0, 10**6)[-1] + 1
    assert len({derived_seed(*parts) for parts in [("a", 1), ("a1",), ("a", 2), (1, "a")]}) == 4


@pytest.mark.slow
def test_equal_entries_are_written_to_equal_files(tmp_path: Path, make_bundle: MakeBundle) -> None:
    folder = make_bundle()
    names = [
        write_entry(tmp_path / "entries", score(folder, "random", episodes=2, max_cycles=10, seed=seed)).name
        for seed in (0, 0, 1)
    ]
    assert names[0] == names[1] != names[2]
    assert len(list((tmp_path / "entries").glob("*.json"))) == 2
