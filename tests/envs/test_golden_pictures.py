"""Scenes made by hand look as they did: `python -m tests.envs.test_golden_pictures` makes them anew.

Look at tests/envs/golden/*.png before you commit them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from xmarl_envs import make_task
from xmarl_envs.render import Renderer
from xmarl_envs.scene import Scene

GOLDEN = Path(__file__).parent / "golden"
NAMES = ["blind_navigation_v0", "blind_passage_v0", "blind_discovery_v0"]


def scene(name: str) -> tuple[Scene, NDArray[np.float64] | None]:
    """A team of five that comes along curves, two of them touching; all but navigation's with a mask."""
    k, t = np.arange(5), np.linspace(0, 1, 50)[:, None]
    if name == "blind_passage_v0":
        slots = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [-0.1, 0.0], [0.0, -0.1]])
        track = np.stack([0.5 * t + 0.2 * t**2 - 0.4, 0.4 * t - 0.8 + 0 * t], axis=-1) + slots
        targets = slots + np.array([-0.5, 0.6])
        walls = np.array([[-1.2 + 0.4, 0.0], [1.303 + 0.4, 0.0]])
    else:
        angle = 2 * np.pi * k / 5 + 1.5 * t
        track = (0.9 - 0.5 * t)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        track[-1, 1] = track[-1, 0] + [0.0, 0.15]
        targets = np.stack([0.2 * k - 0.9, 0.9 - 0.1 * k], axis=-1)
        walls = np.zeros((0, 2))
        if name == "blind_discovery_v0":
            targets = np.array([[0.3, -0.4]])
    mask = None if name == "blind_navigation_v0" else np.abs(np.sin(np.arange(25))).reshape(5, 5)
    collided = np.isin(k, (0, 1))
    return Scene(track, targets, walls, 49, -1.25, 3.5, collided, "" if mask is None else "done"), mask


def drawn(name: str) -> NDArray[np.uint8]:
    picture = Renderer(make_task(name, 5)).draw(*scene(name))
    assert picture is not None
    return picture


@pytest.mark.parametrize("name", NAMES)
def test_pictures_look_as_they_did(name: str) -> None:
    """Exactly, with the pygame of constraints.txt; pygame-ce draws circles and text otherwise."""
    with Image.open(GOLDEN / f"{name}.png") as image:
        golden = np.asarray(image.convert("RGB")).astype(int)
    picture = drawn(name)
    assert picture.shape == golden.shape
    apart = np.abs(picture - golden).max(axis=-1)
    assert (apart > 8).mean() < 1e-3
    assert apart.mean() < 0.1


def main() -> None:
    GOLDEN.mkdir(exist_ok=True)
    for name in NAMES:
        Image.fromarray(drawn(name)).save(GOLDEN / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
