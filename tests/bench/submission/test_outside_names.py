"""Names from outside: copies, strays, and names that a log takes for a command."""

from __future__ import annotations

import sys
import threading
import urllib.error
import urllib.request
from functools import partial
from http.server import ThreadingHTTPServer
from pathlib import Path

import pytest
from pydantic import ValidationError

from tests.conftest import RunCli
from tests.helpers.made_entries import made_entry
from xmarl_bench.board.server import PlainFiles
from xmarl_bench.board.tables import board_of
from xmarl_bench.entry.file import read_entries, write_entry
from xmarl_bench.entry.schema import Entry, make_entry
from xmarl_bench.plugins.names import shipped_policies
from xmarl_bench.policy import PolicyCard
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.default_policies import default_policies
from xmarl_bench.records.strict_json import printable
from xmarl_bench.submission.checking import check
from xmarl_bench.submission.packing import as_submitted


def test_a_copy_and_a_file_with_another_name_are_refused(tmp_path: Path, run_cli: RunCli) -> None:
    path = write_entry(tmp_path / "entries", made_entry("p", "a", 0.5))
    copy = path.with_name("copy.json")
    copy.write_bytes(path.read_bytes())
    ran = run_cli("board", "build", tmp_path)
    assert ran.code == 2
    assert "copy.json should be named" in ran.err
    assert "remove this copy" in ran.err
    findings = check(tmp_path).findings
    assert f"copy.json: its name should be {path.name}." in findings
    assert any("it is the same entry as 'copy.json'" in each for each in findings)
    path.unlink()
    assert "rename it" in run_cli("board", "build", tmp_path).err


def test_a_stray_file_is_named_and_left_out(tmp_path: Path, run_cli: RunCli) -> None:
    path = write_entry(tmp_path / "entries", made_entry("p", "a", 0.5))
    for name in ("._x.json", ".DS_Store", "notes.txt"):
        (tmp_path / "entries" / name).write_bytes(b"\0\5\26\7")
    ran = run_cli("board", "build", tmp_path)
    assert ran.code == 0
    for name in ("._x.json", ".DS_Store", "notes.txt"):
        assert f"{name} is not an entry, and is left out." in ran.err
    assert [each for each, _ in read_entries(tmp_path / "entries")] == [path]
    assert sum("is not an entry" in each for each in check(tmp_path).remarks) == 3


@pytest.mark.skipif(sys.platform == "win32", reason="no such names there")
def test_a_printed_name_is_one_line_and_no_command(tmp_path: Path, run_cli: RunCli) -> None:
    for name in ("a\n::error::b.json", "::add-mask::x.json", "\x1b[2Jx.json", "##[error]x.json"):
        (tmp_path / name).write_text("{}")
        for command in ("validate", "verify"):
            ran = run_cli(command, tmp_path / name)
            assert ran.code == 1
            for line in ran.out.splitlines():
                assert line.isprintable()
                assert not line.lstrip().startswith(("::", "##["))
        (tmp_path / name).unlink()
    assert printable("leaderboard/é.json") == "leaderboard/é.json"


@pytest.mark.parametrize("name", ["=1+1", "@me", "a\nb", "\tx", "-x", "+x", "a\x1b[0m"])
def test_a_submitter_that_is_no_plain_name_is_refused(name: str) -> None:
    entry = made_entry("p", "a", 0.5)
    fields = {each: getattr(entry, each) for each in Entry.model_fields if each != "entry_id"}
    with pytest.raises(ValidationError, match="one line of printable characters"):
        make_entry(**{**fields, "submitter": name})


def test_partial_scores_are_not_ranked_and_same_masks_are_pointed_out() -> None:
    first = made_entry("p", "a", 0.5, submitter="us")
    copied = as_submitted(made_entry("p", "a", 0.5), "them", None, paper="https://example.org/paper")
    copied = copied.model_copy(update={"explainer": copied.explainer.model_copy(update={"name": "b"})})
    other, few = made_entry("p", "c", 0.4, submitter="them"), made_entry("p", "a", 0.5, episodes=7)
    (cell,) = first.results
    short = first.model_copy(update={"results": (cell.model_copy(update={"max_cycles": 30}),)})
    board = board_of([("1", first), ("2", copied), ("3", other), ("4", few), ("5", short)])
    rows = {
        row["file"]: row
        for table in board["tables"]
        for row in table["policies"][0]["rows"]
        if not row["control"]
    }
    assert rows["1"]["same_masks_as"] == [{"explainer": "b", "submitter": "them"}]
    assert rows["2"]["same_masks_as"] == [{"explainer": "a", "submitter": "us"}]
    assert rows["3"]["same_masks_as"] == []
    assert all(rows[file]["rank"] is not None and rows[file]["partial"] is None for file in "123")
    assert rows["2"]["paper"] == "https://example.org/paper"
    assert rows["1"]["date"] == "2026-01-01"
    assert (rows["4"]["rank"], rows["4"]["partial"]) == (None, "7 of the protocol's 50 episodes")
    shorter = "episodes of at most 30 steps, the protocol's have 400"
    assert (rows["5"]["rank"], rows["5"]["partial"]) == (None, shorter)


@pytest.mark.slow
def test_an_explainer_scored_on_some_of_the_protocols_policies_is_pointed_out(tmp_path: Path) -> None:
    cards = default_policies(map(load_card, shipped_policies().values()))

    def write(card: PolicyCard, explainer: str, episodes: int = 50) -> None:
        made = made_entry(
            card.name, explainer, 0.5, task=card.task, n_agents=card.n_agents, episodes=episodes
        )
        content = {name: getattr(made, name) for name in Entry.model_fields if name != "entry_id"}
        policy = made.policy.model_copy(update={"weights_sha256": card.weights_sha256})
        write_entry(tmp_path, make_entry(**{**content, "policy": policy}))

    def said() -> list[str]:
        return [each for each in check(tmp_path).remarks if "whole scores" in each]

    for card in cards:
        write(card, "all")
    write(cards[0], "one")
    for card in cards[:-1]:
        write(card, "few", 7)
    ending = ": valid, but not ranked over all policies."
    n = len(cards)
    assert said() == [
        f"whole scores of few are on 0 of the protocol's {n} policies, none on {cards[0].name} and {n - 1} "
        f"more{ending}",
        f"whole scores of one are on 1 of the protocol's {n} policies, none on {cards[1].name} and {n - 2} "
        f"more{ending}",
    ]
    for each in "few-2", "few-3", "few-4":
        write(cards[0], each, 7)
    assert said()[0].startswith("whole scores of few, few-2, few-3 and 1 more are on 0 of ")
    assert len(said()) == 2
    for card in cards[1:-1]:
        write(card, "one")
    assert said()[1] == (
        f"whole scores of one are on {n - 1} of the protocol's {n} policies, none on {cards[-1].name}{ending}"
    )
    assert not any("whole scores" in each for each in check(next(tmp_path.glob("*.json"))).remarks)


def test_serve_follows_no_link_and_lists_no_folder(tmp_path: Path) -> None:
    board, secret = tmp_path / "board", tmp_path / "secret"
    (board / "pages").mkdir(parents=True)
    (board / "index.html").write_text("page")
    secret.mkdir()
    (secret / "key").write_text("secret")
    (board / "key").symlink_to(secret / "key")
    (board / "pages" / "in").symlink_to(secret)
    found = {}
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(PlainFiles, directory=str(board))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        for path in ("index.html", "", "pages/", "pages", "key", "pages/in/key", "../secret/key"):
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{server.server_port}/{path}") as answer:
                    found[path] = answer.status
            except urllib.error.HTTPError as error:
                found[path] = error.code
        server.shutdown()
    assert found.pop("index.html") == 200
    assert set(found.values()) == {404}
