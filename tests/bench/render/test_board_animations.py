"""Animations of entries are drawn once, show what was scored, and are removed with their entry."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image
from xmarl_envs.canvas import HEADER, LINE, SIZE

from tests.conftest import MakeBundle, RunCli
from tests.helpers.installed import install
from tests.helpers.made_entries import made_entry
from xmarl_bench.board import build_board, check_board
from xmarl_bench.entry.file import write_entry
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.render import animation
from xmarl_bench.render.board_animations import draw_missing
from xmarl_bench.scoring.score import score


@pytest.fixture
def board(tmp_path: Path, make_bundle: MakeBundle, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One entry of an installed policy, and one of a policy that is not installed."""
    bundle = make_bundle(name="small")
    install(monkeypatch, small=bundle)
    monkeypatch.setattr(animation, "FILM_ROWS", 1)
    monkeypatch.setattr(animation, "FILM_COLUMNS", 2)
    folder = tmp_path / "board"
    entry = score(bundle, find_explainer("random"), episodes=1, timesteps=2, max_cycles=6)
    write_entry(folder / "entries", entry)
    write_entry(folder / "entries", made_entry("stranger", "random", 0.5))
    build_board(folder)
    return folder


@pytest.mark.slow
def test_animations_are_drawn_once_and_shown(board: Path, run_cli: RunCli) -> None:
    ran = run_cli("board", "build", board, "--animations")
    assert ran.code == 0, ran.err
    (path,) = (board / "animations").iterdir()
    assert f"{path}: small, random" in ran.out
    assert "stranger, random: no animation: " in ran.out
    with Image.open(path) as image:
        assert image.size == (2 * SIZE, HEADER + LINE + SIZE)
    (data,) = (board / "pages").glob("board-*.js")
    assert path.stem in data.read_text()
    assert check_board(board) == []
    assert [line for line in draw_missing(board) if "no animation" not in line] == []
    page = data.read_bytes()
    path.unlink()
    assert len(check_board(board)) > 0  # the page still shows the removed one
    build_board(board)
    assert next((board / "pages").glob("board-*.js")).read_bytes() != page


@pytest.mark.slow
def test_an_animation_is_removed_with_its_entry(board: Path) -> None:
    list(draw_missing(board))
    build_board(board)
    (animation_file,) = (board / "animations").iterdir()
    next((board / "entries").glob("small.*")).unlink()
    assert f"{animation_file} belongs to no entry." in check_board(board)
    build_board(board)
    assert check_board(board) == []
    assert not animation_file.exists()


@pytest.mark.slow
def test_no_animation_is_drawn_if_the_installed_weights_differ(
    board: Path, make_bundle: MakeBundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch, small=make_bundle(name="again", seed=1))
    (line, _) = draw_missing(board)
    assert line == (
        "small, random: no animation: the installed policy 'small' has other weights: install the one scored."
    )
    assert not (board / "animations").exists()
