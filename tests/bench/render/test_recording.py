"""Recordings have the same episode and masks as scores."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from xmarl_envs import TASKS, make_task

from tests.conftest import MakeBundle
from xmarl_bench.errors import InputError
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import run_explainer
from xmarl_bench.policy import load_policy
from xmarl_bench.render.recording import record
from xmarl_bench.render.team import select_team
from xmarl_bench.reproducible import derived_seed, episode_seeds
from xmarl_bench.rollout.episodes import roll_out


@pytest.mark.parametrize("name", TASKS)
def test_the_episode_equals_the_scored_one(name: str, make_bundle: MakeBundle) -> None:
    policy, _ = load_policy(make_bundle(name))
    task = make_task(name, 3)
    recording = record(task, "small", policy, seed=7, episode=2, max_cycles=20)
    scored = roll_out(task, policy, episode_seeds(7, 3), max_cycles=20)[2]
    np.testing.assert_array_equal(recording.observations, scored.observations)
    scene = recording.track.scene()
    np.testing.assert_array_equal(scene.track[:-1].astype(np.float32), scored.observations[..., :2])
    assert recording.seed == scored.seed
    assert scene.cycle == scored.makespan
    assert scene.total == pytest.approx(scored.reward)
    assert recording.success_rate == scored.success_rate


def test_masks_equal_the_scored_ones(make_bundle: MakeBundle) -> None:
    policy, _ = load_policy(make_bundle())
    recording = record(make_task("blind_navigation_v0", 3), "small", policy, seed=7, episode=1, max_cycles=9)
    random = CONTROLS["random"]
    masks = recording.explain(random, range(9))
    seed = derived_seed("explainer", 7, "random", recording.seed)
    scored = run_explainer(random, policy, torch.tensor(recording.observations), seed)
    np.testing.assert_array_equal(masks, scored.numpy())
    assert recording.explain(random, [4, 8]).shape == (2, 3, 3)


@pytest.mark.parametrize("team", ["heuristic", "random"])
def test_teams_without_a_policy_are_recorded(team: str) -> None:
    first, again, other = (
        record(make_task("blind_passage_v0", 5), team, episode=episode, max_cycles=12)
        for episode in (0, 0, 1)
    )
    np.testing.assert_array_equal(first.observations, again.observations)
    assert (first.observations != other.observations).any()
    with pytest.raises(InputError, match=f"the team is '{team}'"):
        first.explain(CONTROLS["random"], [0])


def test_the_heuristic_does_better_than_random_actions() -> None:
    heuristic, random = (
        record(make_task("blind_navigation_v0", 3), team) for team in ("heuristic", "random")
    )
    assert heuristic.success_rate == 1.0
    assert random.success_rate < 1.0
    assert heuristic.track.scene().ended == "done"
    assert random.track.scene().ended == "time is over"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"seed": -1}, "seed must be"),
        ({"episode": -1}, "episode must be 0 or more, got -1"),
        ({"max_cycles": 0}, "max_cycles must be at least 1, got 0"),
    ],
)
def test_invalid_input_is_refused(options: dict[str, int], said: str) -> None:
    with pytest.raises(InputError, match=said):
        record(make_task("blind_navigation_v0", 3), "random", None, **options)
    with pytest.raises(InputError, match="team 'nobody' has no policy"):
        record(make_task("blind_navigation_v0", 3), "nobody")


def test_several_policies_are_no_team() -> None:
    said = r"'default' is 2 policies \(navigation-n3-.*\): choose one of them by name"
    with pytest.raises(InputError, match=said):
        select_team("default", "blind_navigation_v0", 3)
