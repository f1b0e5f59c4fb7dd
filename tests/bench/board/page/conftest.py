"""A small board, and a browser to show it."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from tests.bench.board.page.browser import browse, chromium
from tests.helpers.made_entries import made_board, made_entry
from xmarl_bench.board import build_board
from xmarl_bench.entry.file import write_entry

__all__ = ["browse", "chromium"]
EXPLAINERS = {"good": 0.9, "fair": 0.6, "bad": 0.3}
HOSTILE = '<img src="x" onerror="document.title = 1">'


@pytest.fixture(scope="session")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four policies (3, 4, 5 and 3 agents, every second one regularised), a failing one, one animation."""
    folder = tmp_path_factory.mktemp("page") / "leaderboard"
    entries = [
        *made_board(["p0", "p1", "p2", "p3"], EXPLAINERS),
        made_entry("failing", "good", 0.9, success_rate=0.2),
        made_entry("hall", "good", 0.8, task="blind_passage_v0", submitter=HOSTILE),
        made_entry("short", "good", 0.7, episodes=10),
    ]
    for entry in entries:
        write_entry(folder / "entries", entry)
    (folder / "animations").mkdir()
    frames = [Image.new("RGB", (80, 60), colour) for colour in ("red", "blue")]
    frames[0].save(
        folder / "animations" / f"{entries[0].entry_id[:16]}.avif", save_all=True, append_images=frames[1:]
    )
    build_board(folder)
    return folder
