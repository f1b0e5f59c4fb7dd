"""Building, checking and serving a board; killed builds."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import threading
import urllib.request
from collections.abc import Callable, Iterator
from http.server import ThreadingHTTPServer
from pathlib import Path

import pytest

from tests.conftest import RunCli
from tests.helpers.made_entries import made_board, made_entry
from xmarl_bench.board import build, build_board, check_board
from xmarl_bench.board.build import derived
from xmarl_bench.entry.file import write_entry

OLD = {"a": 0.9, "b": 0.5}


@pytest.fixture
def board(tmp_path: Path) -> Path:
    """Two policies with two explainers each, built."""
    folder = tmp_path / "board"
    for entry in made_board(["p0", "p1"], OLD):
        write_entry(folder / "entries", entry)
    build_board(folder)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "entries" not in path.parts
    }


@pytest.mark.slow
def test_check_names_stale_files(board: Path, run_cli: RunCli) -> None:
    assert run_cli("board", "check", board).code == 0
    for name in ("leaderboard.json", "leaderboard.csv", "index.html", "entry.html"):
        whole = (board / name).read_bytes()
        (board / name).write_bytes(whole.replace(b"e", b"f", 1))
        ran = run_cli("board", "check", board)
        assert ran.code == 1
        assert ran.out.splitlines() == [f"{board / name} is stale.", f"Run: xmarl-bench board build {board}"]
        (board / name).write_bytes(whole)
    page = next((board / "pages").glob("p0-*.js"))
    page.rename(page.with_name("other.js"))
    assert check_board(board) == [f"{page} is missing.", f"{board / 'pages/other.js'} belongs to no entry."]
    assert run_cli("board", "build", board).code == 0
    assert check_board(board) == []


@pytest.mark.slow
def test_a_board_without_its_page_is_checked_by_its_tables(board: Path) -> None:
    for path in (board / "index.html", board / "entry.html", *(board / "pages").iterdir()):
        path.unlink()
    assert check_board(board) == []
    (board / "leaderboard.csv").unlink()
    assert check_board(board) == [f"{board / 'leaderboard.csv'} is missing."]


@pytest.mark.slow
def test_check_finds_new_removed_and_changed_entries(board: Path, run_cli: RunCli) -> None:
    path = write_entry(board / "entries", made_entry("p0", "c", 0.3))
    assert run_cli("board", "check", board).code == 1
    build_board(board)
    assert check_board(board) == []
    path.unlink()
    assert run_cli("board", "check", board).code == 1
    path.write_text("{}")
    ran = run_cli("board", "check", board)
    assert ran.code == 2
    assert path.name in ran.err


@pytest.mark.parametrize("command", ["build", "check", "serve"])
def test_commands_refuse_a_folder_without_a_board(tmp_path: Path, run_cli: RunCli, command: str) -> None:
    ran = run_cli("board", command, tmp_path / "nothing")
    assert ran.code == 2
    assert len(ran.err.splitlines()) == 1
    assert str(tmp_path / "nothing") in ran.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_csv_has_the_numbers_of_the_json(board: Path) -> None:
    lines = list(csv.DictReader(io.StringIO((board / "leaderboard.csv").read_text())))
    made = json.loads((board / "leaderboard.json").read_text())
    listed = [
        (table, policy, row)
        for table in made["tables"]
        for policy in table["policies"]
        for row in policy["rows"]
    ]
    assert len(lines) == len(listed) == 2 * (2 + 8)
    for line, (table, policy, row) in zip(lines, listed, strict=True):
        assert (line["task"], line["n_agents"]) == (table["task"], str(table["n_agents"]))
        assert (line["policy"], line["explainer"]) == (policy["name"], row["explainer"])
        assert line["rank"] == ("" if row["rank"] is None else str(row["rank"]))
        order = row["metrics"]["message_fidelity"]
        assert float(line["message_fidelity"]) == order["value"]
        assert float(line["message_fidelity_high"]) == order["interval"][1]
        assert line["entry_id"] == (row["entry_id"] or "")


@pytest.mark.slow
def test_an_entry_changes_few_lines_of_the_json(board: Path) -> None:
    before = (board / "leaderboard.json").read_text().splitlines()
    write_entry(board / "entries", made_entry("p0", "c", 0.3))
    build_board(board)
    after = (board / "leaderboard.json").read_text().splitlines()
    assert len(set(after) - set(before)) < len(after) / 3


@pytest.mark.slow
def test_the_chart_of_budgets_has_the_curves_of_the_entries(board: Path) -> None:
    (page,) = (board / "pages").glob("p1-*.js")
    found = json.loads(re.sub(r"^globalThis\.\w+=|;\n$", "", page.read_text()))
    messages, edges = found["charts"]  # four agents; the same curve in every episode
    assert "<td>0.333</td><td>0.667</td><td>1.000</td>" in edges.partition(">oracle</th>")[2]
    assert "<td>0.000</td>" * 3 in edges.partition(">random</th>")[2]
    assert "<td>0.450 [0.450, 0.450]</td><td>0.900 [0.900, 0.900]</td>" in messages.partition(">a</th>")[2]


@pytest.mark.slow
def test_serve_answers_on_this_machine(board: Path, run_cli: RunCli, monkeypatch: pytest.MonkeyPatch) -> None:
    served: dict[str, object] = {}

    def serve_one(server: ThreadingHTTPServer) -> None:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        url = f"http://127.0.0.1:{server.server_port}/leaderboard.json"
        with urllib.request.urlopen(url) as answer:
            served["board"] = json.load(answer)
        thread.join()
        served["address"] = server.server_address[0]

    monkeypatch.setattr(ThreadingHTTPServer, "serve_forever", serve_one)
    ran = run_cli("board", "serve", board, "--port", 0)
    assert ran.code == 0
    assert "http://127.0.0.1:" in ran.out
    assert served["board"] == json.loads((board / "leaderboard.json").read_text())
    assert served["address"] == "127.0.0.1"


# Killed builds: the child is killed before its k-th change of the disk, for every k.


def changes(kill_at: int | None) -> Callable[[], int]:
    """Patch, in this process, all changes of files; die before the k-th. Returns a counter of changes."""
    count = 0

    def counted(call: Callable[..., object]) -> Callable[..., object]:
        def called(*arguments: object, **options: object) -> object:
            nonlocal count
            if count == kill_at:
                os.kill(os.getpid(), 9)
            count += 1
            return call(*arguments, **options)

        return called

    os.fsync = counted(os.fsync)  # type: ignore[assignment]
    Path.replace = counted(Path.replace)  # type: ignore[method-assign,assignment]
    Path.unlink = counted(Path.unlink)  # type: ignore[method-assign,assignment]
    return lambda: count


def build_in_child(folder: Path, kill_at: int | None) -> int:
    """The number of changes that the build made, or -1 if it was killed."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        count = changes(kill_at)
        build_board(folder)
        os.write(write, str(count()).encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    return int(said) if said else -1


def links(folder: Path) -> Iterator[Path]:
    """All files that the pages need."""
    for page in ("index.html", "entry.html", "scores.html"):
        found = re.findall(r'(?:src|href)="(pages/[^"]*)"', (folder / page).read_text())
        assert found
        for link in found:
            yield folder / link
            if re.match(r"pages/board-\w+\.js", link):
                for script in re.findall(r'"script":"([^"]*)"', (folder / link).read_text()):
                    yield folder / script


def lay_out(folder: Path, files: dict[str, bytes]) -> None:
    """Make the folder hold exactly these files."""
    for path in folder.rglob("*"):
        if path.is_file():
            path.unlink()
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


@pytest.mark.slow
def test_a_killed_build_leaves_a_complete_board(board: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = contents(board)
    next((board / "entries").glob("p1.*")).unlink()
    write_entry(board / "entries", made_entry("p0", "c", 0.7))
    write_entry(board / "entries", made_entry("new", "a", 0.7))
    made = derived(board)
    monkeypatch.setattr(build, "derived", lambda folder: made)  # constant, and without changes of files
    total = build_in_child(board, None)
    new = contents(board)
    assert new == made.files
    assert total > 10
    pages_of_new = set()
    for kill_at in range(total):
        lay_out(board, old)
        assert build_in_child(board, kill_at) == -1
        now = contents(board)
        for name in ("leaderboard.json", "leaderboard.csv", "index.html", "entry.html"):
            assert now[name] in (old[name], new[name]), f"{name} is incomplete when killed at {kill_at}"
        for needed in links(board):
            path = f"pages/{needed.name}"
            assert needed.read_bytes() in (old.get(path), new.get(path))
        pages_of_new.add(now["index.html"] == new["index.html"])
        if now["leaderboard.json"] == old["leaderboard.json"]:
            assert now["index.html"] == old["index.html"]  # the page comes last
        build_board(board)  # the next build completes it and cleans up
        assert contents(board) == new
    assert pages_of_new == {True, False}
