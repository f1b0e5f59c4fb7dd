"""The pages in Chromium: answers, tables, charts and links, on all screens, light and dark, and on paper."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.bench.board.page.browser import Browse, violations
from tests.bench.board.page.conftest import HOSTILE, LONG
from xmarl_bench.board import build_board
from xmarl_bench.board.columns import COLUMNS

WIDTHS = (390, 820, 1440)
OF_COLOURS = ("color-contrast", "link-in-text-block")  # rules of axe-core


def column(page: Page, table: str, number: int) -> list[str]:
    """Texts of the n-th cell of the visible rows."""
    cells = page.locator(f"{table} tbody tr:not([hidden]):not(.group) > :nth-child({number})")
    return [text.strip() for text in cells.all_inner_texts()]


def values(texts: list[str]) -> list[float]:
    return [float(re.split(r"[\s\[]", text.replace("\u2212", "-"))[0]) for text in texts]


def pages_of(board: Path) -> list[str]:
    """The largest page of each kind: of an explainer, a task, a cell, and those alone of their kind."""
    of_kind: dict[str, Path] = {}
    for path in sorted(board.rglob("*.html"), key=lambda each: (each.stat().st_size, each.name)):
        kind = re.sub(r"-.*?(-n\d+)?\.html$", lambda match: "-cell" if match[1] else "", path.name)
        of_kind[kind] = path
    found = [path.relative_to(board).as_posix() for path in of_kind.values()]
    first = next(path for path in (board / "entries").glob("*.json"))
    identity = json.loads(first.read_bytes())["entry_id"][:16]
    return sorted([*found, f"entry.html#{identity}"])


def test_the_ranking_equals_that_of_the_json(board: Path, browse: Browse) -> None:
    made = json.loads((board / "leaderboard.json").read_text())
    ranked = [row for row in made["rankings"][0]["rows"] if row["rank"] is not None]
    page = browse(board / "index.html")
    assert column(page, "#ranking", 2) == [row["explainer"] for row in ranked]
    assert values(column(page, "#ranking", 3)) == pytest.approx([row["value"] for row in ranked], abs=5.1e-4)
    assert [place[0] for place in column(page, "#ranking", 1)] == ["1", "2", "3"]
    assert [place[-1] for place in column(page, "#ranking", 1)] == ["a", "b", "c"]  # tie groups
    page.get_by_role("button", name="controls (8)").click()
    assert len(column(page, "#ranking", 2)) == 3 + 8
    page.reload()
    assert len(column(page, "#ranking", 2)) == 3 + 8  # what is open is in the address


def test_without_scripts_the_pages_say_the_same(board: Path, browse: Browse) -> None:
    for name in ("index.html", "pages/ranking-blind_navigation_v0-n3.html", "pages/explainer-good.html"):
        shown = [
            browse(board / name, java_script_enabled=scripts, own=board)
            .locator("main p, td")
            .all_text_contents()
            for scripts in (True, False)
        ]
        assert shown[0] == shown[1]
        assert len(shown[0]) > 20


def test_every_number_is_under_its_heading(board: Path, browse: Browse) -> None:
    made = json.loads((board / "leaderboard.json").read_text())
    table = next(t for t in made["tables"] if t["policies"][0]["name"] == "hall")
    row = next(row for row in table["policies"][0]["rows"] if row["entry_id"])
    page = browse(board / "scores.html", "#task=blind_passage_v0&columns=all")
    headings = [text.replace("\u00a0", " ") for text in page.locator("#scores thead th").all_inner_texts()]
    cells = page.locator("#scores tbody tr").first.locator("td, th").all_inner_texts()
    assert len(headings) == 4 + len(COLUMNS) + 3
    shown = dict(zip(headings, cells, strict=True))
    for heading, metric in (
        ("message fidelity \u2191", "message_fidelity"), ("Fid+ \u2191", "fid_plus"),
        ("Fid\u2212 \u2193", "fid_minus"), ("FidDelta \u2191", "fid_delta"), ("GEF \u2193", "gef"),
        ("mask mass", "mask_mass"), ("shuffled weights", "weight_randomisation"),
    ):  # fmt: skip
        assert values([shown[heading]]) == pytest.approx([row["metrics"][metric]["value"]], abs=5.1e-4), (
            heading
        )
    assert shown["badge"].split()[0] == "re-executed"
    assert shown["submitter"] == HOSTILE
    assert shown["ms \u2193"] == "1"


def test_the_best_comes_first_whichever_way_is_good(board: Path, browse: Browse) -> None:
    page = browse(board / "scores.html")
    headings = [text.replace("\u00a0", " ") for text in page.locator("#scores thead th").all_inner_texts()]
    for heading, higher in (("FidDelta \u2191", True), ("GEF \u2193", False)):
        number = 1 + headings.index(heading)
        button = page.get_by_role("button", name=heading, exact=True)
        button.click()
        first = values(column(page, "#scores", number))
        assert first == sorted(first, reverse=higher)
        button.press("Enter")
        then = values(column(page, "#scores", number))
        assert then == sorted(then, reverse=not higher)
        expect(page.locator("#scores [aria-sort]")).to_have_count(1)
        expect(page.get_by_text("worst first.")).to_be_visible()
    page.reload()
    assert values(column(page, "#scores", number)) == then  # the order is in the address


def test_filters_are_in_the_address(board: Path, browse: Browse) -> None:
    page = browse(board / "scores.html")
    assert len(column(page, "#scores", 1)) == 4 * 3 + 1
    page.get_by_label("Task").select_option("blind_navigation_v0")
    page.get_by_label("Team size").select_option("3")
    assert len(column(page, "#scores", 1)) == 2 * 3
    expect(page.get_by_role("button", name="not ranked (1)")).to_be_visible()
    page.locator("#policy").select_option(label="p3, 3 agents")
    assert len(column(page, "#scores", 1)) == 3
    expect(page.locator("#policy-note")).to_contain_text("p3: attention-entropy weight 0.5, success 0.90")
    page.get_by_label("Search").fill("fair")
    assert column(page, "#scores", 2) == ["fair"]
    page.reload()
    assert column(page, "#scores", 2) == ["fair"]
    page.locator("#policy").select_option(label="failing, 3 agents")
    expect(page.locator("#policy-note")).to_contain_text("Not ranked: success rate 0.200, under 0.5.")
    page.get_by_label("Team size").select_option("5")
    page.get_by_label("Search").fill("")
    assert set(column(page, "#scores", 3)) == {"p2"}  # a missing policy is dropped from the address
    page.get_by_label("Protocol").select_option(label="xmarl-3, 10 episodes, every timestep")
    expect(page.locator("#policy-note")).to_contain_text("No rows match")
    page.get_by_label("Team size").select_option("")
    page.get_by_role("button", name=re.compile("not ranked")).click()  # partial scores
    assert set(column(page, "#scores", 3)) == {"short"}


def test_a_heading_explains_itself_and_leads_to_its_definition(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    heading = page.get_by_role("button", name="Fid\u2212 \u2193", exact=True)
    tip = page.locator("#tip")
    heading.hover()
    expect(tip).to_contain_text("Change of the action with the explanation alone; lower is better.")
    page.keyboard.press("Escape")
    expect(tip).to_be_hidden()
    heading.focus()
    expect(tip).to_be_visible()
    tip.get_by_role("link", name="Definition").click()
    expect(page.locator("dt:has(+ #def-fid_minus)")).to_contain_text("Fid\u2212")
    expect(page.locator("#def-fid_minus")).to_be_in_viewport()


def test_tables_are_saved_as_shown(board: Path, browse: Browse) -> None:
    page = browse(board / "scores.html", "#task=blind_passage_v0", accept_downloads=True)
    for button, ending in (("CSV", "csv"), ("LaTeX", "tex")):
        with page.expect_download() as download:
            page.get_by_role("button", name=button, exact=True).click()
        text = Path(download.value.path()).read_text()
        assert download.value.suggested_filename == f"scores.{ending}"
        assert "good" in text
        assert "0.8" in text
        assert len(text.strip().splitlines()) == (2 if ending == "csv" else 7)
    assert "$\\uparrow$" in text


def test_lines_are_coloured_by_their_chips(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    figure = page.locator("figure[data-lines]").first
    expect(figure.locator("g.line.on")).to_have_count(1)
    figure.get_by_role("button", name="fair").click()
    expect(figure.locator("g.line.on")).to_have_count(2)
    figure.get_by_role("button", name="good").click()
    expect(figure.locator("g.line.on")).to_have_attribute("data-line", "fair")


def test_a_team_of_five_is_shown_first(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    expect(page.get_by_text("p2: FidDelta against the budget, messages between agents")).to_be_visible()


def test_a_heading_of_the_scores_says_how_to_read_it(board: Path, browse: Browse) -> None:
    page = browse(board / "scores.html")
    page.get_by_role("button", name="message fidelity \u2191").click()
    expect(page.locator("#tip")).to_contain_text("higher is better")


def test_a_cell_opens_its_ranking(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html")
    page.locator(".heatmap tbody tr").first.locator("td a").first.click()
    expect(page.locator("h1")).to_have_text("Who wins: navigation, 3 agents")
    page.get_by_role("link", name="navigation", exact=True).click()
    expect(page.locator("h1")).to_have_text("Who wins: navigation")
    expect(page.locator(".lead")).to_contain_text("over 4 policies")


def test_an_explainer_is_known_by_its_card(board: Path, browse: Browse) -> None:
    page = browse(board / "pages/explainer-good.html", own=board)
    expect(page.locator("main")).to_contain_text("pip install made==1")
    expect(page.locator("main")).to_contain_text("Somebody, \u201cA paper\u201d (2020)")
    expect(page.locator("main")).to_contain_text("On planted truth it fails with decoy (0.60)")
    expect(page.locator("dl").first).to_contain_text("resample")
    page.get_by_role("link", name="hall", exact=True).click()
    expect(page.locator("h1")).to_have_text("good on hall")
    expect(browse(board / "pages/explainer-bad.html", own=board).locator("dl").first).to_contain_text(
        "not declared"
    )


def test_pages_fit_screens_and_are_accessible(board: Path, browse: Browse) -> None:
    """Only tables scroll sideways, and axe-core finds nothing, with all charts drawn and groups open.

    axe-core's rules are checked on the narrowest and the widest screen, which show all elements between them,
    and in the dark those on colours, since nothing else differs there (`board.css`).
    """
    for name in pages_of(board):
        file, _, fragment = name.partition("#")
        page = browse(board / file, fragment and f"#{fragment}", own=board)
        if fragment:
            expect(page.locator("#budgets figure").first).to_be_visible()
        folded = page.locator("[aria-expanded=false]")
        for _ in range(folded.count()):
            folded.first.click()
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 900})
            assert page.evaluate("document.documentElement.scrollWidth") <= width, (name, width)
            if width in (WIDTHS[0], WIDTHS[-1]):
                page.emulate_media(color_scheme="dark")
                assert violations(page, *OF_COLOURS) == [], (name, width, "dark")
                page.emulate_media(color_scheme="light")
                assert violations(page) == [], (name, width)
        page.context.close()


def test_pages_work_from_a_server(board: Path, browse: Browse) -> None:
    with serving(board) as url:
        page = browse(f"{url}/index.html")
        expect(page.locator("#ranking tbody tr").first).to_be_visible()
        page.get_by_role("link", name="all scores").click()
        expect(page.locator("#scores tbody tr").first).to_be_visible()
        page.locator("#scores tbody a").first.click()
        expect(page.locator("h1")).to_contain_text(" on ")


def test_paper_is_white_and_has_no_navigation(board: Path, browse: Browse) -> None:
    page = browse(board / "index.html", color_scheme="dark")
    page.emulate_media(media="print")
    expect(page.locator("body")).to_have_css("background-color", "rgb(255, 255, 255)")
    expect(page.locator("nav")).to_be_hidden()
    expect(page.locator(".tools").first).to_be_hidden()
    expect(page.locator(".lead").first).to_be_visible()
    assert page.locator(".scroll").first.evaluate("e => getComputedStyle(e).overflowX") == "visible"


def test_submitted_text_is_escaped(board: Path, browse: Browse) -> None:
    page = browse(board / "scores.html", "#task=blind_passage_v0")
    assert HOSTILE in page.locator("#scores").inner_text()
    assert page.locator("table img").count() == 0


def test_sixty_explainers_and_long_names_break_nothing(crowded: Path, browse: Browse) -> None:
    page = browse(crowded / "index.html")
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    ranked = column(page, "#ranking", 2)
    assert len(ranked) == 60
    assert LONG in ranked
    assert (crowded / "index.html").stat().st_size < 700_000


def test_a_board_of_one_explainer(lonely: Path, browse: Browse) -> None:
    page = browse(lonely / "index.html")
    expect(page.locator(".lead").first).to_have_text(re.compile("alone leads .* over 1 policy"))
    assert column(page, "#ranking", 2) == ["alone"]
    assert violations(page) == []


def test_an_empty_board_is_shown(tmp_path: Path, browse: Browse) -> None:
    build_board(tmp_path)
    page = browse(tmp_path / "index.html")
    expect(page.get_by_text("No entries yet")).to_be_visible()
    assert violations(page) == []
    browse(tmp_path / "scores.html")
    browse(tmp_path / "entry.html")


def test_many_rows_are_sorted_in_a_few_layouts(board: Path, browse: Browse) -> None:
    """2,000 rows are put in once each. A sort that reads positions meanwhile takes 2,000 layouts."""
    page = browse(board / "index.html")
    page.evaluate(MANY_ROWS)
    shown = page.locator("#many tbody tr:not([hidden])")
    expect(shown).to_have_count(100)
    page.get_by_role("button", name="Show all 2000 rows").click()
    expect(shown).to_have_count(2000)
    devtools = page.context.new_cdp_session(page)
    devtools.send("Performance.enable")

    def layouts() -> float:
        listed = devtools.send("Performance.getMetrics")["metrics"]
        return next(float(each["value"]) for each in listed if each["name"] == "LayoutCount")

    before = layouts()
    assert page.evaluate(SORTED) == 2000
    assert layouts() - before < 20
    expect(shown).to_have_count(2000)
    assert values(column(page, "#many", 1))[:3] == [1999.0, 1998.0, 1997.0]


# Clicks, waits for the next frame, and gives the number of rows that were put in.
SORTED = """() => new Promise((done) => {
  const seen = new MutationObserver(() => {});
  seen.observe(document.querySelector("#many tbody"), { childList: true });
  document.querySelector("#many thead button").click();
  const rows = seen.takeRecords().reduce((sum, { addedNodes }) => sum + addedNodes.length, 0);
  requestAnimationFrame(() => setTimeout(() => done(rows)));
})"""
MANY_ROWS = """() => {
  const row = (k) => element("tr", {}, element("td", {}, String((k * 7) % 2000)));
  const rows = Array.from({ length: 2000 }, (_, k) => row(k));
  const heading = element("th", { "data-sort": "higher" }, element("button", {}, "number"));
  const head = element("thead", {}, element("tr", {}, heading));
  document.body.append(element("table", { id: "many" }, head, element("tbody", {}, ...rows)));
  enhance(document.getElementById("many"));
}"""


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """The address at which the folder is served on this machine."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass
