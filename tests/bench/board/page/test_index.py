"""The leaderboard in Chromium: its numbers, sorting, filtering, charts, keyboard, small and dark screens."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.bench.board.page.browser import Browse
from tests.bench.board.page.conftest import HOSTILE
from xmarl_bench.board.columns import COLUMNS

ALL_ROWS = 4 * (3 + 8) + 2 * (1 + 8)  # explainers and controls of the policies with 50 episodes


def column(page: Page, table: str, number: int) -> list[str]:
    return [text.strip() for text in page.locator(f"#{table} tbody td:nth-child({number})").all_inner_texts()]


def total(page: Page) -> int:
    found = re.search(r"of (\d+) rows", page.locator(".dt-info").inner_text())
    return int(found[1]) if found else 0


def values(texts: list[str]) -> list[float]:
    return [float(re.split(r"[\s\[]", text.replace("\u2212", "-"))[0]) for text in texts]


def test_the_ranking_equals_that_of_the_json(board: Path, browse: Browse) -> None:
    made = json.loads((board / "leaderboard.json").read_text())
    ranking = next(each for each in made["rankings"] if each["task"] is None and len(each["policies"]) > 1)
    page = browse(board / "index.html")
    rows = sorted(ranking["rows"], key=lambda row: -row["value"])
    shown = [name.split()[0] for name in column(page, "ranking", 2)]
    assert shown[:3] == [row["explainer"] for row in rows[:3]]
    assert sorted(shown[3:]) == sorted(row["explainer"] for row in rows[3:])  # controls, all of 0.1
    assert values(column(page, "ranking", 3)) == pytest.approx([row["value"] for row in rows], abs=6e-4)
    places = column(page, "ranking", 1)
    assert [place[0] for place in places[:3]] == ["1", "2", "3"]
    assert [place[-1] for place in places[:3]] == ["a", "b", "c"]  # tie groups
    assert set(places[3:]) == {"\u2013"}
    colours = page.locator("#ranking tbody tr").evaluate_all(
        "all => all.map(e => getComputedStyle(e).backgroundColor)"
    )
    assert len(set(colours[:3])) == 1
    assert set(colours[3:]) != set(colours[:3])  # controls are shaded


def test_every_number_is_under_its_heading(board: Path, browse: Browse) -> None:
    made = json.loads((board / "leaderboard.json").read_text())
    table = next(t for t in made["tables"] if t["policies"][0]["name"] == "hall")
    row = next(row for row in table["policies"][0]["rows"] if row["entry_id"])
    page = browse(board / "index.html", "#task=blind_passage_v0&kind=0&columns=all")
    headings = page.locator("#scores thead .dt-column-title").all_inner_texts()
    cells = page.locator("#scores tbody tr").first.locator("td").all_inner_texts()
    assert len(headings) == 4 + len(COLUMNS) + 1
    shown = dict(zip(headings, cells, strict=True))
    for heading, metric in (
        ("message fidelity \u2191", "message_fidelity"), ("Fid+ \u2191", "fid_plus"),
        ("Fid\u2212 \u2193", "fid_minus"), ("FidDelta \u2191", "fid_delta"), ("GEF \u2193", "gef"),
        ("mask mass", "mask_mass"), ("shuffled weights \u2193", "weight_randomisation"),
    ):  # fmt: skip
        assert values([shown[heading]]) == pytest.approx([row["metrics"][metric]["value"]], abs=6e-4), heading
    assert shown["verification"].split()[0] == "re-executed"


def test_sorting_by_click_and_by_keyboard(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    heading = page.locator("#scores thead th").filter(has_text="FidDelta")
    heading.get_by_role("button").click()
    first = values(column(page, "scores", 8))
    assert first == sorted(first, reverse=True)
    expect(heading).to_have_attribute("aria-sort", "descending")
    heading.get_by_role("button").press("Enter")
    then = values(column(page, "scores", 8))
    assert then == sorted(then)
    assert then[0] == pytest.approx(0.1)  # the controls
    assert first[0] > 0.85
    expect(heading).to_have_attribute("aria-sort", "ascending")
    ranking = page.locator("#ranking thead th").filter(has_text="explainer")
    ranking.get_by_role("button").click()
    expect(ranking).to_have_attribute("aria-sort", re.compile("ascending|descending"))
    names = column(page, "ranking", 2)
    assert names == sorted(names)


def test_filters_are_in_the_address(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    assert total(page) == ALL_ROWS
    page.locator("#kind").select_option("0")
    assert total(page) == 4 * 3 + 2
    page.get_by_label("Task").first.select_option("blind_navigation_v0")
    page.get_by_label("Team size").first.select_option("3")
    assert total(page) == 2 * 3 + 1
    assert {text.split()[0] for text in column(page, "ranking", 2)} >= {"good", "fair", "bad"}
    assert "2 policies" in page.locator("#ranking-note").inner_text()
    page.locator("#policy").select_option(label="p3, 3 agents")
    assert total(page) == 3
    note = page.locator("#policy-note")
    assert note.inner_text().startswith("p3: attention-entropy weight 0.5, success 0.90")
    page.get_by_label("Search").fill("fair")
    assert total(page) == 1
    page.reload()
    assert total(page) == 3  # the address holds the choice but not the search
    assert column(page, "scores", 3) == ["p3"] * 3
    page.locator("#policy").select_option(label="failing, 3 agents")
    assert note.inner_text().endswith("Not ranked: success rate 0.200, under 0.5.")
    assert column(page, "scores", 1) == ["not ranked"]
    page.get_by_label("Team size").first.select_option("5")
    assert column(page, "scores", 3) == ["p2"] * 3  # a missing policy is dropped from the address


def test_one_protocol_is_shown_at_a_time(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    assert "short" not in set(column(page, "scores", 3))
    page.get_by_label("Protocol").select_option(label="xmarl-3, 10 episodes, every timestep")
    assert set(column(page, "scores", 3)) == {"short"}


def test_budget_curves_show_explainers_random_and_oracle(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    page.locator("#budget-title").scroll_into_view_if_needed()
    page.locator("#budget-policy").select_option(label="p2, 5 agents")
    page.locator("#budget-kind").select_option("budget")
    figure = page.locator("#budget-figure")
    expect(figure.locator("svg[aria-label='FidDelta against the budget k']")).to_be_visible()
    expect(figure.locator("g[aria-label=line] path")).to_have_count(5)  # three explainers, random, oracle
    figure.get_by_text("The numbers").click()
    lines = [line.split("\t") for line in figure.locator("tbody").inner_text().splitlines()]
    good = [(int(k), float(mean)) for name, k, mean, _ in lines if name == "good"]
    assert good == [(1, 0.225), (2, 0.45), (3, 0.675), (4, 0.9)]  # five agents, 0.9 at the end
    assert [float(mean) for name, _, mean, _ in lines if name == "oracle"] == [0.25, 0.5, 0.75, 1.0]


def test_performance_profiles_and_probabilities_of_improvement(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    page.locator("#profile-title").scroll_into_view_if_needed()
    figure = page.locator("#profile-figure")
    expect(figure.locator("svg[aria-label='Share of policies above a score']")).to_be_visible()
    expect(figure.locator("g[aria-label=line] path")).to_have_count(3)
    expect(figure.locator("g[aria-label=area] path")).to_have_count(1)  # the band of the chosen one
    page.locator("#profile-explainer").select_option("fair")
    expect(figure.get_by_text("Probability that fair does better")).to_be_attached()
    figure.get_by_text("The numbers").click()
    lines = [line.split("\t") for line in figure.locator("tbody").inner_text().splitlines()]
    assert lines == [["good", "0.00"], ["bad", "1.00"]]
    page.get_by_label("Task").first.select_option("blind_navigation_v0")  # without a size there is no ranking
    expect(figure.get_by_text("Nothing is ranked here.")).to_be_visible()


def test_two_selections_have_violins(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    page.locator("#violin-title").scroll_into_view_if_needed()
    figure = page.locator("#violin-figure")
    expect(figure.locator("g[aria-label=area] path")).to_have_count(6)  # three explainers in A and B
    page.locator("#a-policy").select_option("p0")
    page.locator("#b-explainer").select_option("bad")
    page.locator("#b-agents").select_option("4")
    page.get_by_label("Metric").last.select_option("gef")
    expect(figure.locator("g[aria-label=area] path")).to_have_count(4)
    figure.get_by_text("The numbers").click()
    lines = [line.split("\t") for line in figure.locator("tbody").inner_text().splitlines()]
    assert [(name, side, count) for name, side, count, *_ in lines] == [
        ("bad", "A", "50"), ("bad", "B", "50"), ("fair", "A", "50"), ("good", "A", "50"),
    ]  # fmt: skip
    assert float(lines[3][3]) == pytest.approx(0.9, abs=0.02)


def test_links_lead_to_existing_pages(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html", "#kind=0")
    links = page.locator("#scores tbody a").evaluate_all("all => all.map(e => e.getAttribute('href'))")
    identities = {link.removeprefix("entry.html#") for link in links}
    assert len(links) == len(identities) == 4 * 3 + 2
    page.locator("#scores tbody a").first.click()
    expect(page.locator("h1")).to_have_text(re.compile(r"^\w+ on "))
    page.get_by_role("link", name="Leaderboard").click()
    expect(page.locator("h1")).to_have_text("xmarl-bench leaderboard")
    for name in ("leaderboard.json", "leaderboard.csv", "their licences"):
        target = page.get_by_role("link", name=name).get_attribute("href")
        assert target
        assert (board / target).is_file()


def test_submitted_text_is_escaped(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html", "#task=blind_passage_v0&kind=0")
    assert HOSTILE in column(page, "scores", 2)[0]
    assert page.locator("table img").count() == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_is_readable_on_a_phone_in_light_and_dark(board: Path, browse: Browse, scheme: str) -> None:
    """Only tables scroll sideways, and text has enough contrast (WCAG AA: 4.5 to 1)."""
    page = browse(board / "index.html", color_scheme=scheme, viewport={"width": 360, "height": 740})
    for figure in ("#profile-figure", "#budget-figure", "#violin-figure"):
        page.locator(figure).scroll_into_view_if_needed()
        expect(page.locator(f"{figure} svg").last).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    ground = page.locator("body").evaluate("e => getComputedStyle(e).backgroundColor")
    shade = page.locator("tr.control").first.evaluate("e => getComputedStyle(e).backgroundColor")
    assert (luminance(ground) > 0.5) == (scheme == "light")
    for selector, behind in (("h1", ground), (".dim", ground), ("#scores td", ground), ("main a", ground),
                             ("tr.control td", shade), (".badge", ground)):  # fmt: skip
        ink = page.locator(selector).first.evaluate("e => getComputedStyle(e).color")
        assert contrast(ink, behind) >= 4.5, selector


def test_without_scripts_the_ranking_is_shown(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html", java_script_enabled=False)
    rows = page.locator("noscript table").first.locator("tbody tr")
    expect(rows.first).to_be_visible()
    assert rows.first.locator("th").inner_text() == "good"


def test_an_empty_board_is_shown(tmp_path: Path, browse: Browse) -> None:
    from xmarl_bench.board import build_board

    build_board(tmp_path)
    page = browse(tmp_path / "index.html")
    expect(page.get_by_text("No entries yet")).to_be_visible()


def luminance(colour: str) -> float:
    """Relative luminance of "rgb(...)", WCAG 2.1."""
    channels = [int(x) / 255 for x in re.findall(r"\d+", colour)[:3]]
    linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(ink: str, ground: str) -> float:
    low, high = sorted((luminance(ink), luminance(ground)))
    return (high + 0.05) / (low + 0.05)
