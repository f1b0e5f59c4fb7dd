"""Pictures: of the right shape, with everybody in them, and without effect on the episode."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from xmarl_envs import TASKS, TaskParallelEnv, make_task
from xmarl_envs.render import SIZE, WALL, agent_colours

tasks = pytest.mark.parametrize("name", TASKS)


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def rendered(env: TaskParallelEnv) -> NDArray[np.uint8]:
    frame = env.render()
    assert frame is not None
    return frame


def has_colour(frame: NDArray[np.uint8], colour: tuple[int, int, int]) -> bool:
    return bool((frame == np.array(colour)).all(axis=-1).any())


@tasks
@pytest.mark.parametrize("n_agents", [1, 3, 5])
def test_everybody_is_in_the_picture(name: str, n_agents: int) -> None:
    env = TaskParallelEnv(make_task(name, n_agents), render_mode="rgb_array")
    env.reset(seed=0)
    frame = rendered(env)
    assert frame.shape == (SIZE, SIZE, 3)
    assert frame.dtype == np.uint8
    assert all(has_colour(frame, colour) for colour in agent_colours(n_agents))
    assert has_colour(frame, WALL) == (name == "blind_passage_v0")
    assert not has_colour(frame, agent_colours(n_agents + 1)[-1])
    env.close()


def test_sixty_four_agents_have_colours_of_their_own() -> None:
    assert len(set(agent_colours(64))) == 64
    env = TaskParallelEnv(make_task("blind_navigation_v0", 64), render_mode="rgb_array")
    env.reset(seed=0)
    frame = rendered(env)
    assert all(has_colour(frame, colour) for colour in agent_colours(64))


def test_up_is_up_and_right_is_right() -> None:
    env = TaskParallelEnv(make_task("blind_navigation_v0", 1), render_mode="rgb_array")
    where = []
    for seed in range(2):
        observation, _ = env.reset(seed=seed)
        x, y = observation["agent_0"][:2]
        rows, columns = np.nonzero((rendered(env) == agent_colours(1)[0]).all(axis=-1))
        where.append((x, y, columns.mean(), rows.mean()))
    (x0, y0, column0, row0), (x1, y1, column1, row1) = where
    assert np.sign(x1 - x0) == np.sign(column1 - column0)
    assert np.sign(y1 - y0) == -np.sign(row1 - row0)


@tasks
@pytest.mark.parametrize("render_mode", ["rgb_array", "human"])
def test_looking_changes_nothing(name: str, render_mode: str) -> None:
    states = []
    for mode in (None, render_mode):
        env = TaskParallelEnv(make_task(name, 3), render_mode=mode)
        env.reset(seed=0)
        for _ in range(5):
            env.step({agent: np.full(2, 0.5, dtype=np.float32) for agent in env.agents})
            if mode is not None:
                assert (env.render() is None) == (mode == "human")
        states.append(env.state())
        env.close()
    np.testing.assert_array_equal(states[0], states[1])


def test_the_picture_follows_the_episode() -> None:
    env = TaskParallelEnv(make_task("blind_discovery_v0", 3), render_mode="rgb_array")
    env.reset(seed=0)
    before = rendered(env)
    np.testing.assert_array_equal(before, rendered(env))
    for _ in range(10):
        env.step({agent: np.ones(2, dtype=np.float32) for agent in env.agents})
    assert (rendered(env) != before).any()


def test_unknown_modes_and_none_are_refused() -> None:
    with pytest.raises(ValueError, match="render_mode must be one of"):
        TaskParallelEnv(make_task("blind_navigation_v0"), render_mode="ansi")
    with pytest.raises(ValueError, match="nothing to render"):
        TaskParallelEnv(make_task("blind_navigation_v0")).render()
