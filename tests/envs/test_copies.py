"""Environments are copied and pickled within an episode and go on as the original does, bit for bit."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pettingzoo import AECEnv
from xmarl_envs import TASKS, VectorEnv, blind_navigation_v0, make_task
from xmarl_envs.gymnasium_vector_env import TeamVectorEnv
from xmarl_envs.info_at_reset import InfoAtReset
from xmarl_envs.parallel import TaskParallelEnv
from xmarl_envs.sb3_vec_env import AgentVecEnv

STEPS = 40  # before the copy, and after it
Copy = Callable[[Any], Any]
copies = pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"]
)


def together(position: NDArray[Any], noise: NDArray[Any]) -> NDArray[Any]:
    """Everybody pushes to one place, so that a team is in contact all the time."""
    middle = position.mean(axis=-2, keepdims=True)
    push: NDArray[Any] = np.clip(4 * (middle - position) + 0.3 * noise, -1, 1)
    return push


def play(env: VectorEnv, steps: int, seed: int, live: Any = None) -> list[NDArray[Any]]:
    """What every step returned."""
    rng, seen = np.random.default_rng(seed), []
    for _ in range(steps):
        noise = rng.uniform(-1, 1, env.action_shape)
        seen += [np.array(each) for each in env.step(together(env.state.position, noise), live)]
    return seen


def assert_same(ours: list[NDArray[Any]], theirs: list[NDArray[Any]]) -> None:
    assert len(ours) == len(theirs) > 0
    assert all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


def exact(value: object) -> str:
    """All of a value, with every digit."""
    with np.printoptions(floatmode="unique", threshold=1_000_000):
        return repr(value)


@copies
@pytest.mark.parametrize("name", TASKS)
def test_episodes_in_contact_go_on(name: str, copied: Copy) -> None:
    env = VectorEnv(make_task(name, 5), n_episodes=3)
    env.reset([1, 2, 3])
    before = play(env, STEPS, seed=0)
    env.reset([4], [1])  # episodes of different ages
    play(env, STEPS, seed=1, live=np.array([True, True, False]))
    other = copied(env)
    assert np.array_equal(other.state.position, env.state.position)
    after = play(env, STEPS, seed=2)
    assert all(np.array(seen[5::7]).any() for seen in (before, after))  # agents touched
    assert_same(play(other, STEPS, seed=2), after)
    env.reset([5, 6, 7])
    other.reset([5, 6, 7])
    assert_same(play(other, 5, seed=3), play(env, 5, seed=3))


@copies
def test_an_episode_that_was_restarted_goes_on(copied: Copy) -> None:
    env = VectorEnv(make_task("blind_navigation_v0"), n_episodes=2)
    env.reset([1, 2])
    play(env, STEPS, seed=0)
    env.restart(1, env.state.position.copy(), env.state.velocity.copy())
    play(env, 3, seed=1)
    other = copied(env)
    assert_same(play(other, STEPS, seed=2), play(env, STEPS, seed=2))


@pytest.mark.slow
@copies
@pytest.mark.parametrize("wrapped", [False, True])
def test_parallel_envs_go_on_into_the_next_episodes(wrapped: bool, copied: Copy) -> None:
    env: Any = blind_navigation_v0.parallel_env(n_agents=5, max_cycles=STEPS + 10)
    env = InfoAtReset(env) if wrapped else env
    env.reset(seed=3)

    def played(env: Any, steps: int) -> list[Any]:
        rng, seen = np.random.default_rng(0), []
        for _ in range(steps):
            if not env.agents:
                env.reset()
            seen.append(env.step({agent: rng.uniform(-1, 1, 2) for agent in env.agents}))
            seen.append(env.state())
        return seen

    played(env, STEPS)
    other = copied(env)
    assert exact(played(other, 2 * STEPS)) == exact(played(env, 2 * STEPS))


@copies
def test_aec_envs_go_on(copied: Copy) -> None:
    env = blind_navigation_v0.env(n_agents=3)
    env.reset(seed=3)

    def played(env: AECEnv[str, Any, Any]) -> list[Any]:
        rng, seen = np.random.default_rng(0), []
        for _ in env.agent_iter(60):
            seen.append(env.last())
            env.step(rng.uniform(-1, 1, 2).astype(np.float32))
        return seen

    played(env)
    other = copied(env)
    assert exact(played(other)) == exact(played(env))


@copies
@pytest.mark.parametrize("kind", [AgentVecEnv, TeamVectorEnv])
def test_vector_envs_of_other_libraries_go_on(kind: Any, copied: Copy) -> None:
    env = kind(make_task("blind_navigation_v0"), 2, max_cycles=STEPS + 10)
    if kind is AgentVecEnv:
        env.seed(3)
        env.reset()
    else:
        env.reset(seed=3)

    def played(env: Any) -> list[Any]:
        rng = np.random.default_rng(0)
        shape = (6, 2) if kind is AgentVecEnv else (2, 3, 2)
        return [env.step(rng.uniform(-1, 1, shape)) for _ in range(STEPS)]

    played(env)
    other = copied(env)
    assert exact(played(other)) == exact(played(env))


@copies
def test_a_copy_draws_the_same_picture(copied: Copy) -> None:
    env: TaskParallelEnv = blind_navigation_v0.parallel_env(render_mode="rgb_array")
    env.reset(seed=0)
    env.step({agent: np.ones(2) for agent in env.agents})
    picture, other = env.render(), copied(env)
    assert picture is not None
    assert np.array_equal(other.render(), picture)
    env.close()
    other.close()


def test_shared_spaces_refuse_after_a_contact() -> None:
    env = VectorEnv(make_task("blind_navigation_v0", 5), n_episodes=4, copies_per_space=4)
    env.reset([1, 2, 3, 4])
    copy.deepcopy(env)
    play(env, STEPS, seed=0)
    with pytest.raises(TypeError, match="copies_per_space=1"):
        pickle.dumps(env)


@pytest.mark.parametrize("kind", [AgentVecEnv, TeamVectorEnv])
def test_vector_envs_take_a_parallel_env(kind: Any) -> None:
    env = blind_navigation_v0.parallel_env(n_agents=4, max_cycles=7)
    ours = kind(env)
    assert (ours.task, ours._env.max_cycles) == (env.task, 7)
    assert kind(env, max_cycles=9)._env.max_cycles == 9
    for other in (blind_navigation_v0.env(), InfoAtReset(env), "blind_navigation_v0"):
        with pytest.raises(TypeError, match=r"takes a task or parallel_env\(...\), got"):
            kind(other)
    with pytest.raises(ValueError, match="draws nothing, got render_mode='rgb_array'"):
        kind(blind_navigation_v0.parallel_env(render_mode="rgb_array"))
