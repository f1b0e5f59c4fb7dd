"""PettingZoo environments as tasks: our own give the same episodes, and unsuitable ones are refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from xmarl_envs import TASKS, TaskParallelEnv, make_task

from tests.bench.tasks import worlds
from tests.helpers.policies import small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.rollout.episodes import Episode, mean_metrics, play, roll_out
from xmarl_bench.tasks import sources
from xmarl_bench.tasks.interface import TeamTask, random_actions
from xmarl_bench.tasks.parallel_task import ParallelEpisodes
from xmarl_bench.tasks.parallel_trial import parallel_task

SEEDS = (10**12, 10**12 + 1, 10**12 + 2)


def bits(episodes: list[Episode]) -> list[tuple[object, ...]]:
    return [
        tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in vars(e).values()) for e in episodes
    ]


@pytest.mark.slow
@pytest.mark.parametrize("continuous", [True, False], ids=["continuous", "discrete"])
@pytest.mark.parametrize("name", TASKS)
def test_our_tasks_give_the_same_episodes_through_their_parallel_env(name: str, continuous: bool) -> None:
    ours = make_task(name, 3, continuous_actions=continuous)
    policy = small_policy(ours.obs_dim, categorical=not continuous)
    theirs = parallel_task(
        name, lambda n: TaskParallelEnv(make_task(name, n, continuous_actions=continuous)), 3
    )
    assert theirs.default_max_cycles == ours.default_max_cycles
    assert (theirs.obs_dim, theirs.action_width) == (ours.obs_dim, ours.action_width)
    expected = roll_out(ours, policy, SEEDS, max_cycles=60)
    assert bits(roll_out(theirs, policy, SEEDS, max_cycles=60)) == bits(expected)
    assert bits(roll_out(theirs, policy, SEEDS, max_cycles=60, parallel_episodes=1)) == bits(expected)


def test_at_random_our_teams_collide_as_often_through_their_parallel_env() -> None:
    """In a crowd, so that both kinds of episodes occur."""
    task = make_task("blind_passage_v0", 5)
    theirs = parallel_task("passage", lambda n: TaskParallelEnv(make_task("blind_passage_v0", n)), 5)

    def at_random(each: TeamTask) -> list[Episode]:
        rng = np.random.default_rng(0)

        def act(seen: NDArray[np.float32], slots: Sequence[int]) -> tuple[NDArray[Any], NDArray[np.float32]]:
            return random_actions(each, len(seen), rng).astype(np.float32), seen[..., :0]

        return play(each, act, SEEDS, max_cycles=15)

    ours, through = at_random(task), at_random(theirs)
    assert bits(ours) == bits(through)
    assert {0.0, 1.0} == {episode.no_agent_collision for episode in ours}


def test_infos_tell_success_at_the_end_and_collisions_at_any_step() -> None:
    task = parallel_task("told", worlds.told, 3)
    (episode,) = roll_out(task, small_policy(2), (5,))
    assert episode.success_rate == pytest.approx(2 / 3)
    assert (episode.no_agent_collision, episode.no_object_collision) == (0.0, 1.0)
    assert episode.makespan == 6
    place = np.random.default_rng(5).uniform(size=3)
    assert episode.reward == pytest.approx(6 * place.mean())
    assert episode.observations[2, :, 0] == pytest.approx(place)
    assert mean_metrics(task, [episode])["success_rate"] == pytest.approx(2 / 3)


def test_what_infos_do_not_tell_is_not_a_number() -> None:
    task = parallel_task("line", worlds.line, 3)
    (episode,) = roll_out(task, small_policy(2), (5,), max_cycles=4)
    assert episode.makespan == 4
    untold = (episode.success_rate, episode.no_agent_collision, episode.no_object_collision)
    assert np.isnan(untold).all()
    means = mean_metrics(task, [episode])
    assert means == {**dict.fromkeys(means), "reward": episode.reward, "makespan": 4.0}


def test_a_collision_that_is_told_counts_though_infos_are_silent_otherwise() -> None:
    task = parallel_task("happened", worlds.TellsWhatHappened, 3)
    episodes = roll_out(task, small_policy(2), range(20))
    lucky = [episode.observations[0, 0, 0] > 0.5 for episode in episodes]
    assert 0 < sum(lucky) < 20
    for episode, known in zip(episodes, lucky, strict=True):
        collision, success = (0.0, 1.0) if known else (np.nan, np.nan)
        np.testing.assert_equal((episode.no_agent_collision, episode.success_rate), (collision, success))


def test_policies_of_another_task_and_impossible_numbers_of_episodes_are_refused() -> None:
    task = make_task("blind_passage_v0", 3)
    with pytest.raises(InputError, match="takes observations of 6 entries, got 8: choose a policy trained"):
        roll_out(task, small_policy(6), (1,))
    with pytest.raises(InputError, match="parallel_episodes must be at least 1, got 0"):
        roll_out(task, small_policy(8), (1,), parallel_episodes=0)


def test_actions_are_scaled_to_the_box() -> None:
    task = parallel_task("line", worlds.line, 3)
    env = task.vector_env(1)
    assert isinstance(env, ParallelEpisodes)
    env.reset([1])
    env.step(np.array([[[-1.0, 1.0], [0.0, 0.0], [0.5, 7.0]]], np.float32))
    inside: Any = env.envs[0]
    taken = np.stack([inside.actions[agent] for agent in inside.possible_agents])
    assert taken == pytest.approx(np.array([[0.0, 6.0], [0.5, 2.0], [0.75, 6.0]]))


@pytest.mark.parametrize(("make", "said"), worlds.BAD.values(), ids=worlds.BAD)
def test_what_cannot_be_scored_is_refused_in_one_sentence(make: Callable[[int], Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        parallel_task("mine", make, 3)
    assert str(refused.value).startswith("task 'mine'") or "in task 'mine'" in str(refused.value)


@pytest.mark.parametrize("bad", [worlds.one_too_many, worlds.Pictures, worlds.Endless])
def test_an_environment_that_is_refused_is_closed(bad: Callable[[int], worlds.Line]) -> None:
    made = []

    def make(n_agents: int) -> worlds.Line:
        made.append(bad(n_agents))
        return made[-1]

    with pytest.raises(InputError):
        parallel_task("mine", make, 3)
    assert [env.closed for env in made] == [True]


def test_max_cycles_may_be_a_number_of_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worlds.Line, "max_cycles", np.int64(6))
    assert parallel_task("mine", worlds.Line, 3).default_max_cycles == 6


@pytest.mark.parametrize("make", [worlds.spread, worlds.spread_continuous, worlds.pursuit])
def test_environments_of_others_are_taken(make: Callable[[int], Any]) -> None:
    task = parallel_task("theirs", make, 4)
    env = make(4)
    agent = env.possible_agents[0]
    assert env.observation_space(agent).shape == (task.obs_dim,)
    assert task.action_width == 5
    assert task.continuous_actions == (make is worlds.spread_continuous)
    assert task.default_max_cycles == (30 if make is worlds.pursuit else 25)


@dataclass
class Unhashable:
    name: str = "unhashable"

    def __call__(self, n_agents: int) -> worlds.Line:
        return worlds.Line(n_agents)


def test_a_factory_that_cannot_be_hashed_is_refused() -> None:
    with pytest.raises(InputError, match=r"cannot be hashed \(.*Unhashable.*\): give a function"):
        sources.open_task(Unhashable())


def test_environments_are_closed_when_nobody_plays_them_any_more() -> None:
    open_ = set[int]()

    class Closing(worlds.Line):
        def reset(self, seed: int | None = None, options: Any = None) -> Any:
            open_.add(id(self))
            return super().reset(seed, options)

        def close(self) -> None:
            open_.discard(id(self))

    task = parallel_task("closing", Closing, 3)
    assert open_ == set()
    env = task.vector_env(2)
    env.reset([0, 1])
    env.reset([2], [0])
    assert len(open_) == 2
    del env
    assert open_ == set()


def test_the_other_kind_of_actions_is_refused() -> None:
    task = parallel_task("spread", worlds.spread, 3)
    with pytest.raises(InputError, match="takes discrete actions and the policy chooses continuous ones"):
        roll_out(task, small_policy(18), (1,))
