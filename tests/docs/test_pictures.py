"""The pictures of README.md and envs/README.md equal the output of docs/make_pictures.py."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytestmark = pytest.mark.slow
DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def made() -> dict[str, Image.Image]:
    pictures: dict[str, Image.Image] = runpy.run_path(str(DOCS / "make_pictures.py"))["pictures"]()
    return pictures


def test_no_picture_is_missing(made: dict[str, Image.Image]) -> None:
    assert set(made) <= {path.name for path in DOCS.glob("*.png")}


@pytest.mark.parametrize("name", ["tasks", "blind_navigation_v0", "blind_passage_v0", "blind_discovery_v0"])
def test_pictures_are_up_to_date(name: str, made: dict[str, Image.Image]) -> None:
    """Compared at an eighth of the size, because text and edges depend on the version of pygame.

    If this fails, run docs/make_pictures.py and look at the pictures.
    """
    with Image.open(DOCS / f"{name}.png") as image:
        kept = image.convert("RGB")
    assert kept.size == made[f"{name}.png"].size
    old, new = (np.asarray(each.reduce(8)).astype(int) for each in (kept, made[f"{name}.png"].convert("RGB")))
    assert np.abs(old - new).mean() < 0.5
