"""Episodes have the bits of those whose own Space takes every step."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from xmarl_envs import TASKS, make_task, separate_spaces
from xmarl_envs.separate_spaces import SeparateSpaces, flight_has_the_bits_of_a_space
from xmarl_envs.slotted_space import SlottedSpace
from xmarl_envs.task import Floats
from xmarl_envs.vector_env import VectorEnv

STEPS = 80


def wander(env: VectorEnv, step: int, pushes: Floats) -> None:
    """A step of teams that gather in the middle, then scatter: crowds, borders, walls."""
    towards = np.clip(-2 * env.state.position, -1, 1) if step % 40 < 25 else 3 * pushes
    live = np.arange(env.n_episodes) % 4 != step // 60
    env.step(np.clip(towards + 0.3 * pushes, -1, 1), live)


def played(name: str, n_agents: int, n_episodes: int, copied_at: int | None = None) -> Floats:
    """(STEPS, 2, B, N, 2): positions and velocities of teams, some of which begin anew or drop out."""
    rng = np.random.default_rng(7)
    env = VectorEnv(make_task(name, n_agents), n_episodes)
    env.reset(range(n_episodes))
    seen, pushes = [], rng.uniform(-1, 1, (n_episodes, n_agents, 2))
    for step in range(STEPS):
        if step == copied_at:
            env = pickle.loads(pickle.dumps(env))
        if step == STEPS // 2:
            env.reset([100, 101], episodes=[1, n_episodes - 1])
        wander(env, step, pushes)
        seen.append(np.stack([env.state.position, env.state.velocity]))
    return np.array(seen)


@pytest.mark.slow
@pytest.mark.parametrize("n_episodes", [3, 12])  # flying one by one, and together
@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("n_agents", [1, 2, 3, 5])
def test_episodes_have_the_bits_of_their_own_spaces(
    name: str, n_agents: int, n_episodes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = played(name, n_agents, n_episodes)
    assert (played(name, n_agents, n_episodes, copied_at=55) == flown).all()
    monkeypatch.setattr(separate_spaces, "LARGEST_FLYING_TEAM", 0)
    assert (played(name, n_agents, n_episodes) == flown).all()


def test_all_kinds_of_steps_occur() -> None:
    """A crowd is in its own Spaces, pairs are in borrowed ones, and teams that are apart fly again."""
    env = VectorEnv(make_task("blind_navigation_v0", 5), 12)
    env.reset(range(12))
    spaces = env.world._spaces
    assert isinstance(spaces, SeparateSpaces)
    pushes = np.random.default_rng(7).uniform(-1, 1, (12, 5, 2))
    kinds = []
    for step in range(STEPS):
        wander(env, step, pushes)
        kinds.append((len(spaces._in_own), len(spaces._lent), int(spaces._flying.sum())))
        assert sum(kinds[-1]) == 12
    own, lent, flying = np.array(kinds).T
    assert own.max() > 3
    assert lent.max() > 1
    assert flying[0] == 12
    assert flying[-1] > flying.min()


def test_free_flight_builds_no_space(monkeypatch: pytest.MonkeyPatch) -> None:
    """A team of one in an open plane touches nothing."""
    assert flight_has_the_bits_of_a_space()
    monkeypatch.setattr(separate_spaces, "SlottedSpace", None)  # building one would fail
    for n_episodes in (1, 8):
        env = VectorEnv(make_task("blind_navigation_v0", 1), n_episodes)
        env.reset(range(n_episodes))
        for _ in range(70):
            env.step(np.full((n_episodes, 1, 2), 0.5))
        assert (env.state.velocity > 0.1).all()


def test_memory_does_not_grow_with_the_number_of_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """pymunk never frees a batch's Buffer: a SlottedSpace per episode would leak some kB each."""
    built = []

    class Counted(SlottedSpace):
        def __init__(self, *arguments: object) -> None:
            super().__init__(*arguments)  # type: ignore[arg-type]
            built.append(self)

    monkeypatch.setattr(separate_spaces, "SlottedSpace", Counted)
    env = VectorEnv(make_task("blind_navigation_v0", 5), 3)
    pushes = np.random.default_rng(7).uniform(-1, 1, (3, 5, 2))
    for _ in range(8):
        env.reset(range(3))
        for step in range(25):
            wander(env, step, pushes)
    assert 0 < len(built) <= 6  # of each episode its own, and one that it borrowed
