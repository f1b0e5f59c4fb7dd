"""Draws scenes for tests, and finds colours in pictures."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from xmarl_envs import TASKS, Task, TaskParallelEnv
from xmarl_envs.canvas import HEADER
from xmarl_envs.colours import PAPER, Colour
from xmarl_envs.render import Renderer
from xmarl_envs.scene import Scene

tasks = pytest.mark.parametrize("name", TASKS)
Picture = NDArray[np.uint8]
Floats = NDArray[np.float64]


def rendered(env: TaskParallelEnv, mask: Floats | None = None) -> Picture:
    frame = env.render(mask)
    assert frame is not None
    return frame


def drawn(
    task: Task, scene: Scene, mask: Floats | None = None, title: str = "", reach: float = 0.0
) -> Picture:
    frame = Renderer(task, reach=reach).draw(scene, mask, title)
    assert frame is not None
    return frame


def scene_of(*agents: tuple[float, float], track: Floats | None = None, collided: int | None = None) -> Scene:
    """A team at the given positions, with its goals far above."""
    positions = np.array(agents)
    return Scene(
        track=positions[None] if track is None else track,
        targets=positions + np.array([0.0, 50.0]),
        walls=np.zeros((0, 2)),
        cycle=0,
        reward=0.0,
        total=0.0,
        collided=np.arange(len(agents)) == collided,
    )


def count(frame: Picture, colour: Colour) -> int:
    return int((frame == np.array(colour)).all(axis=-1).sum())


def darkness(frame: Picture, x: float, y: float, reach: int = 12) -> float:
    """Mean darkness relative to paper around a pixel of the world."""
    column, row = round(x), round(y) + HEADER
    patch = frame[row - reach : row + reach, column - reach : column + reach]
    return float(np.mean(np.array(PAPER) - patch.astype(np.float64)))


def at(frame: Picture, colour: Colour) -> tuple[float, float]:
    """Mean column and row, below the header, of the pixels of a colour."""
    rows, columns = np.nonzero((frame[HEADER:] == np.array(colour)).all(axis=-1))
    return float(columns.mean()), float(rows.mean())
