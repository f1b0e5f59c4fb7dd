"""Boards of no, one, three and sixty explainers, and a browser to show them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image

from tests.bench.board.page.browser import browse, chromium
from tests.helpers.made_entries import made_board, made_entry
from xmarl_bench.board import ORDER, build_board
from xmarl_bench.board.build import CARDS
from xmarl_bench.entry.file import write_entry
from xmarl_bench.entry.schema import Entry, FreshDifference, FreshSeeds, Verification, entry_id
from xmarl_bench.render.animation import FILM_COLUMNS, FILM_ROWS

__all__ = ["browse", "chromium"]
EXPLAINERS = {"good": 0.9, "fair": 0.6, "bad": 0.3}
CARD = {"summary": "made for tests", "absence": "resample", "paper": "Somebody, \u201cA paper\u201d (2020)",
        "planted": {"decoy": 0.6, "one-sender": 1.0}}  # fmt: skip
LONG = "an-explainer-with-a-name-of-one-hundred-characters".ljust(100, "x")
HOSTILE = '<img src="x" onerror="document.title = 1">'


def with_fresh(entry: Entry, less: float) -> Entry:
    """The entry with a claim of 12 variants, and so much less of the headline metric on fresh seeds."""
    found = FreshDifference(public=0.9, fresh=0.9 - less, difference=less, interval=(less - 0.1, less + 0.1))
    fresh = FreshSeeds(value="0123abc", by="B", when="2026", episodes=50, cells=({ORDER["by"]: found},))
    block = Verification(status="re-executed", by="A", fresh=fresh)
    claimed = entry.model_copy(update={"variants_tried": 12, "verification": block})
    return claimed.model_copy(update={"entry_id": entry_id(claimed)})


@pytest.fixture(scope="session")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four policies (3, 4, 5 and 3 agents, every second one regularised), a failing one, two films of p0."""
    folder = tmp_path_factory.mktemp("page") / "leaderboard"
    entries = [
        *made_board(["p0", "p1", "p2", "p3"], EXPLAINERS),
        made_entry("failing", "good", 0.9, success_rate=0.2),
        with_fresh(made_entry("hall", "good", 0.8, task="blind_passage_v0", submitter=HOSTILE), 0.4),
        made_entry("short", "good", 0.7, episodes=10),
    ]
    for entry in entries:
        write_entry(folder / "entries", entry)
    (folder / "animations").mkdir()
    film = Image.new("RGB", (FILM_COLUMNS * 64, FILM_ROWS * 74), "red")
    film.paste("blue", (64, 0, 128, 74))  # the second picture
    for entry in entries[:2]:
        film.save(folder / "animations" / f"{entry.entry_id[:16]}.avif")
    (folder / CARDS).write_text(json.dumps({"good": CARD}))
    build_board(folder)
    return folder


@pytest.fixture(scope="session")
def crowded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixty explainers on a policy, one of them with a name of 100 characters."""
    folder = tmp_path_factory.mktemp("crowded")
    for k in range(60):
        name = LONG if k == 30 else f"explainer_number-{k}"
        write_entry(
            folder / "entries", made_entry("policy", name, k / 60, n_agents=5, submitter=f"Submitter {k}")
        )
    build_board(folder)
    return folder


@pytest.fixture(scope="session")
def lonely(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lonely")
    write_entry(folder / "entries", made_entry("policy", "alone", 0.7))
    build_board(folder)
    return folder
