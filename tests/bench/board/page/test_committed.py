"""The committed board: its tables are up to date, and its first view leads to what people ask."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.bench.board.page.browser import Browse
from xmarl_bench.board import build_board
from xmarl_bench.board.build import CARDS, TABLES

LEADERBOARD = Path(__file__).parents[4] / "leaderboard"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A board of the committed entries."""
    folder = tmp_path_factory.mktemp("built") / "leaderboard"
    folder.mkdir()
    for name in ("entries", CARDS):
        (folder / name).symlink_to(LEADERBOARD / name)
    build_board(folder)
    return folder


def test_the_tables_are_up_to_date(built: Path) -> None:
    stale = [each for each in TABLES if (LEADERBOARD / each).read_bytes() != (built / each).read_bytes()]
    assert stale == []  # if it fails, run: xmarl-bench board build


QUESTIONS = {  # -> the link, and what the answer looks like
    "who wins on passage?": ("passage", r"^[\w-]+( and [\w-]+)? leads? with a message fidelity of"),
    "is GNNExplainer better than chance?": ("gnn_explainer", r"^It is (not shown to be )?better than random"),
    "does the regulariser help attention?": (
        "regulariser",
        r"^Attention-entropy regularisation .* attention",
    ),
    "how do I read this column?": ("definitions", r"^Change of the action .*; higher is better"),
    "how do I submit?": ("submit", r"^Pack the entries: xmarl-bench submit"),
}


def test_five_questions_take_one_click(built: Path, browse: Browse) -> None:
    """The answer is in the view that a link of the committed board's first view opens."""
    for question, (name, answer) in QUESTIONS.items():
        page = browse(built / "index.html", viewport={"width": 1440, "height": 900})
        link = page.get_by_role("link", name=name, exact=True).first
        expect(link, question).to_be_in_viewport()
        link.click()
        expect(page.get_by_text(re.compile(answer)).first, question).to_be_in_viewport()
