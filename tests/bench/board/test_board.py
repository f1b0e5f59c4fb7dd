"""The board: its tables, which policies are ranked, and its files."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from xmarl_envs import BlindNavigation

from tests.helpers.policies import small_policy
from xmarl_bench.board import board_of, build_board
from xmarl_bench.entry import partial
from xmarl_bench.entry.file import write_entry
from xmarl_bench.entry.record import Record
from xmarl_bench.entry.schema import Entry, make_entry
from xmarl_bench.errors import InputError
from xmarl_bench.explain.control_names import NEAREST
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import save_policy
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.scoring.request import Request
from xmarl_bench.scoring.score import entries_of, score_requests

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def entries(tmp_path_factory: pytest.TempPathFactory) -> list[Entry]:
    policies = []
    for seed, name in enumerate(("a", "b")):
        policy = small_policy(6, seed)
        card = save_policy(
            tmp_path_factory.mktemp("policies") / name,
            policy,
            name=name,
            task="blind_navigation_v0",
            n_agents=3,
            attention_entropy=0.5,
        )
        policies.append((policy, card))
    samplings = Sampling(episodes=3, max_cycles=8), Sampling(episodes=2, timesteps=2, max_cycles=8)
    requests = [
        Request(policy, card, find_explainer(name), (Cell(card.task, n),), sampling, 0)
        for policy, card in policies
        for name in ("random", "attention")
        for sampling in samplings
        for n in (3, 4)
    ]
    return list(entries_of(score_requests(requests)))


def passed(entry: Entry, **means: float) -> Entry:
    """The entry with other means; by default those of a policy that passes the gate."""
    (cell,) = entry.results
    good = {"success_rate": 0.9, "success_gain": 0.5, "reward_gain": 0.5}
    changed = {name: {"value": mean, "interval": (mean, mean)} for name, mean in {**good, **means}.items()}
    metrics = cell.metrics.model_copy(
        update={name: getattr(cell.metrics, name).model_copy(update=value) for name, value in changed.items()}
    )
    return entry.model_copy(update={"results": (cell.model_copy(update={"metrics": metrics}),)})


@pytest.fixture(autouse=True)
def _three_short_episodes_are_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(partial, "EPISODES", 3)
    monkeypatch.setattr(BlindNavigation, "default_max_cycles", 8)


def test_only_identical_protocols_share_a_table(entries: list[Entry]) -> None:
    board = board_of([(entry.file_name, passed(entry)) for entry in entries])
    protocols = [board["protocols"][table["protocol"]] for table in board["tables"]]
    shown = [
        (table["n_agents"], protocol["episodes"], protocol["timesteps"])
        for table, protocol in zip(board["tables"], protocols, strict=True)
    ]
    assert shown == [(3, 3, None), (3, 2, 2), (4, 3, None), (4, 2, 2)]
    for table in board["tables"]:
        assert [policy["name"] for policy in table["policies"]] == ["a", "b"]
        for policy in table["policies"]:
            rows = policy["rows"]
            values = [row["metrics"]["message_fidelity"]["value"] for row in rows]
            assert values == sorted(values, reverse=True)
            whole = board["protocols"][table["protocol"]]["timesteps"] is None  # else a partial score
            assert [row["rank"] for row in rows if not row["control"]] == [1 if whole else None]
            assert {row["rank"] for row in rows if row["control"]} == {None}
            assert sorted(row["explainer"] for row in rows) == sorted([*CONTROLS, NEAREST, "attention"])
            # A control scored by itself is shown as its own entry, the others as part of another one.
            assert {row["explainer"] for row in rows if row["entry_id"]} == {"random", "attention"}
    assert board["order"]["by"] == "message_fidelity"


def test_policies_that_fail_or_whose_messages_do_not_help_are_not_ranked(entries: list[Entry]) -> None:
    entry = next(each for each in entries if each.explainer.name == "attention")
    for means, said in (
        ({"success_rate": 0.49}, "success rate 0.490, under 0.5"),
        (
            {"success_rate": 0.5, "success_gain": 0.0, "reward_gain": -0.1},
            "messages are not shown to help: success gained by messages 0.000 (0.000 to 0.000), "
            "reward gained by messages -0.100 (-0.100 to -0.100)",
        ),
        ({"success_rate": 0.5, "success_gain": 0.0, "reward_gain": 0.1}, None),
        ({"success_rate": 0.5, "success_gain": 0.1, "reward_gain": -0.1}, None),
    ):
        board = board_of([("x.json", passed(entry, **means))])
        (policy,) = board["tables"][0]["policies"]
        assert policy["gate"] == said
        (row,) = [row for row in policy["rows"] if row["explainer"] == "attention"]
        assert row["rank"] == (1 if said is None else None)


def test_bytes_depend_only_on_the_entries(tmp_path: Path, entries: list[Entry]) -> None:
    for name, listed in (("one", entries), ("two", entries[::-1])):
        for entry in listed:
            write_entry(tmp_path / name / "entries", entry)
        build_board(tmp_path / name)
    one, two = ({path.relative_to(tmp_path / name): path.read_bytes() for path in files(tmp_path / name)}
                for name in ("one", "two"))  # fmt: skip
    assert one == two
    build_board(tmp_path / "one")
    assert {path.relative_to(tmp_path / "one"): path.read_bytes() for path in files(tmp_path / "one")} == one
    board = json.loads(one[Path("leaderboard.json")])
    for table in board["tables"]:
        for policy in table["policies"]:
            for row in policy["rows"]:
                assert (tmp_path / "one" / row["file"]).is_file()


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def test_pages_refer_only_to_files_of_the_board(tmp_path: Path, entries: list[Entry]) -> None:
    for entry in entries:
        write_entry(tmp_path / "entries", entry)
    build_board(tmp_path)
    used = set()
    for page in tmp_path.rglob("*.html"):
        for link in re.findall(r'(?:src|href)="([^"]*)"', page.read_text()):
            assert not re.match(r"(https?:)?//", link)
            target, _, place = link.partition("#")
            path = (page.parent / target).resolve() if target else page
            if target != "data:,":
                assert path.exists(), f"{page.name} refers to {link}"
                used.add(path)
            if path.suffix == ".html" and place and "=" not in place and path.name != "entry.html":
                assert f'id="{place}"' in path.read_text(), f"{page.name} refers to {link}"
    (data,) = (tmp_path / "pages").glob("board-*.js")
    scripts = re.findall(r'"script":"([^"]*)"', data.read_text())
    assert len(scripts) == 8  # 2 policies in 4 tables
    assert used >= {path for path in (tmp_path / "pages").iterdir()} - {
        tmp_path / script for script in scripts
    }
    first_view = [path for path in used if path.suffix in (".css", ".js") and path != data]
    assert sum(path.stat().st_size for path in [*first_view, tmp_path / "index.html"]) < 1_000_000


def test_submitted_text_cannot_inject_markup(tmp_path: Path, entries: list[Entry]) -> None:
    hostile = make_entry(
        **{name: getattr(entries[0], name) for name in Entry.model_fields if name != "entry_id"}
        | {"submitter": "</script><script>x</script>"}
    )
    write_entry(tmp_path / "entries", hostile)
    build_board(tmp_path)
    for path in files(tmp_path):
        if path.suffix == ".html":
            assert "<script>x" not in path.read_text()


def test_no_entries_give_an_empty_board(tmp_path: Path) -> None:
    board = json.loads(build_board(tmp_path).read_text())
    assert board["tables"] == []
    assert "No entries yet" in (tmp_path / "index.html").read_text()


def test_an_invalid_entry_is_refused_before_anything_is_written(tmp_path: Path, entries: list[Entry]) -> None:
    path = write_entry(tmp_path / "entries", entries[0])
    path.write_text(path.read_text().replace('"submitter":null', '"submitter":"x"'))
    with pytest.raises(InputError, match=re.escape(path.name)):
        build_board(tmp_path)
    assert not (tmp_path / "leaderboard.json").exists()


def test_records_are_strict() -> None:
    assert Record.model_config.get("extra") == "forbid"
    assert Record.model_config.get("frozen") is True
