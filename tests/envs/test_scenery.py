"""Walls, borders, landmarks and trails are drawn where the task has them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from xmarl_envs import TASKS, Task, make_task
from xmarl_envs.canvas import HEADER, SIZE
from xmarl_envs.colours import NEAR, PAPER, WALL, Colour
from xmarl_envs.render import Renderer
from xmarl_envs.scene import Scene

Floats = NDArray[np.float64]
GAP = 0.4  # m, x of the middle of passage's gap


def scene(task: Task, track: Floats, targets: Floats, walls: Floats | None = None) -> Scene:
    """A scene at the end of a track (cycles, N, 2)."""
    return Scene(
        track=track,
        targets=targets,
        walls=np.zeros((0, 2)) if walls is None else walls,
        cycle=len(track),
        reward=0.0,
        total=0.0,
        collided=np.zeros(task.n_agents, dtype=np.bool_),
    )


def drawn(task: Task, of: Scene) -> NDArray[np.uint8]:
    """The world, without the header."""
    picture = Renderer(task).draw(of)
    assert picture is not None
    assert picture.shape == (HEADER + SIZE, SIZE, 3)
    return picture[HEADER:]


def at(task: Task, x: float, y: float) -> tuple[int, int]:
    """Row and column of a place in metres."""
    metre = SIZE / 2 / (1.06 * (task.bound or task.spawn_half_width) + task.radius)
    return round(SIZE / 2 - y * metre), round(SIZE / 2 + x * metre)


def is_there(world: NDArray[np.uint8], colour: Colour, row: int, column: int) -> bool:
    return tuple(world[row, column]) == tuple(colour)


def test_the_gap_is_where_the_walls_end() -> None:
    task = make_task("blind_passage_v0", 1)
    width, thickness = task.wall_size
    walls = np.array([[GAP - 0.103 / 2 - width / 2, 0.0], [GAP + 0.103 / 2 + width / 2, 0.0]])
    world = drawn(task, scene(task, np.array([[[0.0, -0.8]]]), np.array([[0.0, 0.8]]), walls))
    for x, y, solid in [
        (-0.9, 0.0, True), (GAP - 0.07, 0.0, True), (GAP, 0.0, False), (GAP + 0.07, 0.0, True),
        (0.0, 0.45 * thickness, True), (0.0, -0.45 * thickness, True), (0.0, 0.6 * thickness, False),
    ]:  # fmt: skip
        assert is_there(world, WALL, *at(task, x, y)) is solid, (x, y)


@pytest.mark.parametrize("name", TASKS)
def test_a_border_is_drawn_where_surfaces_stop(name: str) -> None:
    task = make_task(name, 1)
    world = drawn(task, scene(task, np.array([[[0.0, -0.5]]]), np.array([[0.0, 0.5]])))
    edge = (task.bound or 1.0) + task.radius
    for side in (-1, 1):
        row, column = at(task, side * edge, 0.27)
        around = world[row, max(0, column - 3) : column + 4]
        assert bool((around != np.array(PAPER)).any()) == (task.bound is not None)


def test_a_landmark_shows_its_sensing_range() -> None:
    task = make_task("blind_discovery_v0", 1)
    world = drawn(task, scene(task, np.array([[[-0.8, 0.8]]]), np.array([[0.3, -0.4]])))
    rows, columns = np.nonzero((world == np.array(NEAR)).all(axis=-1))
    top, left = at(task, 0.3 - 0.35, -0.4 + 0.35)
    bottom, right = at(task, 0.3 + 0.35, -0.4 - 0.35)
    found = [rows.min(), columns.min(), rows.max(), columns.max()]
    np.testing.assert_allclose(found, [top, left, bottom, right], atol=2)


@pytest.mark.parametrize("name", ["blind_navigation_v0", "blind_discovery_v0"])
def test_a_mirrored_episode_gives_a_mirrored_picture(name: str) -> None:
    """With trails and targets, up to the width of an edge and the numbers on discs."""
    task = make_task(name, 2)
    t = np.linspace(0, 1, 50)[:, None]
    one, two = np.hstack([0.7 - 0.4 * t, t**2 - 0.5]), np.hstack([0.2 * t - 0.6, 0.3 + 0 * t])
    track = np.stack([one, two], axis=1)
    targets = np.array([[0.5, 0.7], [-0.4, -0.8]])[: 1 if name == "blind_discovery_v0" else 2]
    flip = np.array([-1.0, 1.0])
    world, mirrored = (drawn(task, scene(task, track * side, targets * side)) for side in (np.ones(2), flip))
    assert apart(world, mirrored[:, ::-1]) < 0.0025
    assert apart(world, mirrored) > 0.005  # so another picture would fail


def apart(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> float:
    """The share of pixels with different colours."""
    return float((np.abs(one.astype(int) - other).max(axis=-1) > 60).mean())
