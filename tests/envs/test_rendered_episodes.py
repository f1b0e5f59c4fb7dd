"""`render` of an environment: it changes no episode, needs no screen, and refuses what it cannot draw."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any, ClassVar

import numpy as np
import pygame
import pytest
from numpy.typing import NDArray
from xmarl_envs import TaskParallelEnv, make_task

from tests.envs.pictures import Floats, rendered, tasks


@pytest.mark.parametrize(
    ("mask", "said"),
    [
        (np.ones((3, 2)), r"shape \(2, 2\), got \(3, 2\)"),
        (np.full((2, 2), 1.5), r"must lie in \[0, 1\]"),
        (np.full((2, 2), np.nan), r"must lie in \[0, 1\]"),
    ],
)
def test_an_invalid_mask_is_refused(mask: Floats, said: str) -> None:
    env = TaskParallelEnv(make_task("blind_navigation_v0", 2), render_mode="rgb_array")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=said):
        env.render(mask)


def played(name: str, mode: str | None, n_agents: int = 3) -> list[NDArray[np.float32]]:
    env = TaskParallelEnv(make_task(name, n_agents), render_mode=mode)
    env.reset(seed=0)
    states = []
    for _ in range(5):
        env.step({agent: np.full(2, 0.5, dtype=np.float32) for agent in env.agents})
        states.append(env.state())
        if mode is not None:
            assert (env.render(np.full((n_agents, n_agents), 0.5)) is None) == (mode == "human")
    env.close()
    return states


@pytest.mark.slow
@tasks
@pytest.mark.parametrize("render_mode", ["rgb_array", "human"])
def test_rendering_does_not_change_the_episode(name: str, render_mode: str) -> None:
    np.testing.assert_array_equal(played(name, None), played(name, render_mode))


def test_pictures_depend_only_on_the_episode() -> None:
    """The same episode gives the same pictures, whatever was drawn before."""
    env = TaskParallelEnv(make_task("blind_navigation_v0", 3), render_mode="rgb_array")
    env.reset(seed=0)
    first = rendered(env)
    np.testing.assert_array_equal(first, rendered(env))
    for _ in range(60):
        env.step({agent: np.ones(2, dtype=np.float32) for agent in env.agents})
    assert (rendered(env, np.ones((3, 3))) != first).any()
    env.reset(seed=0)
    np.testing.assert_array_equal(first, rendered(env))


class Window(pygame.Window):
    """Counts the pictures that it shows."""

    opened: ClassVar[list[Window]] = []

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.opened.append(self)
        self.n_shown, self.is_open = 0, True

    def flip(self) -> None:
        super().flip()
        self.n_shown += 1

    def destroy(self) -> None:
        super().destroy()
        self.is_open = False


def test_windows_are_closed_one_by_one_and_the_episodes_continue(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pygame, "Window", Window)
    monkeypatch.setattr(Window, "opened", [])
    envs = [TaskParallelEnv(make_task("blind_navigation_v0", 1), render_mode="human") for _ in range(3)]

    def shown_by_a_step() -> list[int]:
        before = [each.n_shown for each in Window.opened]
        for env in envs:
            env.step({"agent_0": np.ones(2, dtype=np.float32)})
        return [each.n_shown - n for each, n in zip(Window.opened, before, strict=True)]

    for env in envs:
        env.reset(seed=0)
    assert shown_by_a_step() == [1, 1, 1]
    pygame.event.post(pygame.event.Event(pygame.WINDOWCLOSE, window=Window.opened[1]))
    shown_by_a_step()
    assert [shown_by_a_step() for _ in range(2)] == [[1, 0, 1]] * 2
    envs.pop(0).close()
    assert shown_by_a_step() == [0, 0, 1]
    assert [each.is_open for each in Window.opened] == [False, False, True]
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert [shown_by_a_step() for _ in range(2)][1] == [0, 0, 0]
    for env in envs:
        env.close()
    assert not any(each.is_open for each in Window.opened)


@pytest.mark.slow
def test_pictures_need_no_screen() -> None:
    """No video driver is available here, and rgb_array needs none."""
    code = (
        "from xmarl_envs import TaskParallelEnv, make_task\n"
        "env = TaskParallelEnv(make_task('blind_navigation_v0'), render_mode='rgb_array')\n"
        "env.reset(seed=0)\n"
        "assert env.render().std() > 1\n"
    )
    environment = {**os.environ, "SDL_VIDEODRIVER": "none-such"}
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100, env=environment)


def test_rendering_with_an_unknown_mode_or_without_a_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="render_mode must be one of"):
        TaskParallelEnv(make_task("blind_navigation_v0"), render_mode="ansi")
    with pytest.raises(ValueError, match="nothing to render: make"):
        TaskParallelEnv(make_task("blind_navigation_v0")).render()
    with pytest.raises(ValueError, match="call reset first"):
        TaskParallelEnv(make_task("blind_navigation_v0"), render_mode="rgb_array").render()
