"""The page of an entry in Chromium."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.bench.board.page.browser import Browse
from xmarl_bench.board.command import command_of
from xmarl_bench.board.page import HERE
from xmarl_bench.entry.file import read_entries
from xmarl_bench.entry.schema import Entry
from xmarl_bench.render.animation import FILM_COLUMNS, FILM_ROWS


def find(board: Path, policy: str, explainer: str = "good") -> Entry:
    entries = [entry for _, entry in read_entries(board / "entries")]
    return next(e for e in entries if (e.policy.name, e.explainer.name) == (policy, explainer))


def test_the_page_shows_numbers_provenance_and_command(board: Path, browse: Browse) -> None:
    entry = find(board, "p1", "fair")
    page = browse(board / "entry.html", f"#{entry.entry_id[:16]}")
    expect(page.locator("h1")).to_have_text("fair on p1")
    assert "fair on p1" in page.title()
    summary = entry.results[0].metrics.gef
    assert summary is not None
    row = page.locator("#metrics tbody tr").filter(has_text="GEF").first.locator("td").all_inner_texts()
    assert float(row[0].split()[0]) == pytest.approx(summary.value, abs=6e-4)
    assert row[1] == "50"
    assert [float(x) for x in row[2:]] == [0.1, 0.1, 0.1]  # random, oracle, inverted
    assert "Rank 2" in page.locator("#summary").inner_text()
    expect(page.locator("#command")).to_have_text(command_of(entry))
    shown = page.locator("#provenance").inner_text()
    for text in (entry.entry_id, entry.policy.weights_sha256, "made:fair", "2026-01-01T00:00:00Z", "Machine"):
        assert text in shown
    link = page.get_by_role("link", name=entry.entry_id).get_attribute("href")
    assert link
    assert (board / link).is_file()
    expect(page.locator("#budgets figure")).to_have_count(2)
    expect(page.locator("#budgets g.line.on").first).to_have_attribute("data-line", "fair")
    page.get_by_role("button", name="Copy").click()
    expect(page.locator("#copied")).not_to_be_empty()


def test_what_fresh_seeds_say_stands_beside_the_badge(board: Path, browse: Browse) -> None:
    entry = find(board, "hall")
    summary = browse(board / "entry.html", f"#{entry.entry_id[:16]}").locator("#summary")
    expect(summary).to_contain_text("re-executed public \u2212 fresh 0.400 [0.300, 0.500] 12 variants tried")
    page = browse(board / "entry.html", f"#{entry.entry_id[:16]}")
    expect(page.locator("#gate")).to_contain_text(
        "It does worse on fresh seeds: message fidelity 0.500 there"
    )
    expect(page.locator("#provenance")).to_contain_text("fresh.value")
    row = browse(board / "scores.html", "#task=blind_passage_v0").locator("#scores tbody tr").first
    expect(row).to_contain_text("public \u2212 fresh 0.400")


@pytest.mark.parametrize("motion", ["no-preference", "reduce"])
def test_an_episode_is_played_paused_and_stepped(board: Path, browse: Browse, motion: str) -> None:
    page = browse(board / "entry.html", f"#{find(board, 'p0').entry_id[:16]}", reduced_motion=motion)
    film, frame, moving = page.locator(".film"), page.locator("#frame"), motion == "no-preference"
    expect(film).to_have_attribute("aria-label", re.compile("first episode of p0"))
    assert page.evaluate("document.querySelector('.film').clientWidth") in (638, 640)
    if moving:
        expect(frame).not_to_have_value("0")
        page.get_by_role("button", name="Pause").click()
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    frame.fill("0")
    page.get_by_role("button", name="Step on").click()
    expect(frame).to_have_value("1")
    expect(film).to_have_css("background-position", "20% 0%")
    red, _, blue = pixel(film.screenshot(), 320, 300)
    assert blue > red  # the second picture
    page.get_by_role("button", name="Step back").click()
    expect(film).to_have_css("background-position", "0% 0%")
    frame.fill("23")
    expect(film).to_have_css("background-position", "100% 100%")


def test_two_explainers_stand_side_by_side(board: Path, browse: Browse) -> None:
    page = browse(board / "entry.html", f"#{find(board, 'p0').entry_id[:16]}", reduced_motion="reduce")
    films, other = page.locator(".film"), page.locator("#beside option").nth(1)
    page.get_by_label("Beside it").select_option(other.get_attribute("value"))
    expect(films).to_have_count(2)
    page.get_by_role("button", name="Step on").click()
    for k in range(2):
        expect(films.nth(k)).to_have_css("background-position", "20% 0%")
    one, two = (films.nth(k).get_attribute("aria-label") for k in range(2))
    assert one != two
    page.get_by_label("Beside it").select_option("")
    expect(films).to_have_count(1)


def test_the_page_knows_the_form_of_a_film() -> None:
    script = (HERE / "assets" / "episode.js").read_text()
    assert f"rows: {FILM_ROWS}, columns: {FILM_COLUMNS}," in script


def pixel(png: bytes, x: int, y: int) -> tuple[int, int, int]:
    with Image.open(io.BytesIO(png)) as image:
        red, green, blue = image.convert("RGB").getpixel((x, y))  # type: ignore[misc]
    return red, green, blue


def test_one_budget_is_shown_as_numbers(board: Path, browse: Browse) -> None:
    """Of three agents, the messages have one budget; all edges have two."""
    page = browse(board / "entry.html", f"#{find(board, 'p0').entry_id[:16]}")
    messages, edges = page.locator("#budgets figure").all()
    expect(messages.locator(".plot")).to_have_count(0)
    expect(messages.locator("tbody tr").first).to_contain_text("0.900 [0.900, 0.900]")
    expect(edges.locator(".plot")).to_be_visible()
    expect(edges.locator(".xticks .tick")).to_have_text(["1", "2"])


def test_pages_work_without_an_animation(board: Path, browse: Browse) -> None:
    identity = find(board, "p2").entry_id[:16]
    page = browse(board / "entry.html", f"#{identity}", viewport={"width": 360, "height": 740})
    expect(page.locator("h1")).to_have_text("good on p2")
    expect(page.locator("#animation")).to_be_hidden()
    expect(page.locator("#budgets figure").first).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 360


def test_the_page_says_if_an_entry_is_not_ranked_or_missing(board: Path, browse: Browse) -> None:
    page = browse(board / "entry.html", f"#{find(board, 'failing').entry_id[:16]}")
    expect(page.locator("#gate")).to_have_text("Not ranked: success rate 0.200, under 0.5.")
    page = browse(board / "entry.html", "#0123456789abcdef")
    expect(page.locator("#summary")).to_have_text("This board has no entry 0123456789abcdef.")
