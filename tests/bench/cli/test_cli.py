"""The command line: its output; invalid input gives one sentence, exit code 2 and no file."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from tests.conftest import MakeBundle, Ran, RunCli
from xmarl_bench.entry.file import read_entries
from xmarl_bench.plugins import names
from xmarl_bench.policy.untrusted import CARD, WEIGHTS

QUICK = ("--episodes", 2, "--max-cycles", 6)


def assert_refused(ran: Ran, out: Path, *said: str) -> None:
    """One sentence on stderr, exit code 2, nothing written."""
    assert ran.code == 2, ran
    lines = ran.err.splitlines()
    assert len(lines) == 1, ran.err
    assert lines[0].startswith("xmarl-bench: ")
    assert lines[0].rstrip().endswith((".", "?"))
    assert "Traceback" not in ran.err + ran.out
    for word in said:
        assert word in lines[0]
    assert ran.out == ""
    assert not out.exists()


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "leaderboard"


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    points = {
        names.EXPLAINERS: [
            EntryPoint(name, f"tests.helpers.example_plugins:{attribute}", names.EXPLAINERS)
            for name, attribute in [
                ("nan", "nan"), ("late-nan", "late_nan"), ("wrong-shape", "wrong_shape"), ("crash", "crash"),
                ("broken", "no_such_name"), ("vandal", "vandal"), ("slow", "slow"),
            ]
        ],
        names.POLICIES: [EntryPoint("broken-policies", "tests.bench.no_such:x", names.POLICIES)],
    }  # fmt: skip
    monkeypatch.setattr(
        names,
        "entry_points",
        lambda group, name=None: [each for each in points[group] if name in (None, each.name)],
    )


@pytest.mark.slow
def test_score_writes_entries_and_board_and_prints_them(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path
) -> None:
    folders = [make_bundle(name="a"), make_bundle("blind_passage_v0", name="b")]
    ran = run_cli(
        "score", "--policy", folders[0], "--policy", folders[1], "--explainer", "attention", "--explainer",
        "all-ones", *QUICK, "--out", out, "--submitter", "me",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    entries = [entry for _, entry in read_entries(out / "entries")]
    assert sorted((entry.policy.name, entry.explainer.name) for entry in entries) == [
        ("a", "all-ones"), ("a", "attention"), ("b", "all-ones"), ("b", "attention"),
    ]  # fmt: skip
    assert {entry.submitter for entry in entries} == {"me"}
    board = json.loads((out / "leaderboard.json").read_text())
    assert [table["task"] for table in board["tables"]] == ["blind_navigation_v0", "blind_passage_v0"]
    assert (out / "index.html").is_file()
    assert str(out / "leaderboard.json") in ran.out
    assert "FidDelta" in ran.out


@pytest.mark.slow
def test_score_twice_writes_the_same_board(run_cli: RunCli, make_bundle: MakeBundle, out: Path) -> None:
    arguments = ("score", "--policy", make_bundle(), "--explainer", "random", *QUICK, "--out", out)
    first, second = ((run_cli(*arguments), (out / "leaderboard.json").read_bytes())[1] for _ in range(2))
    assert first == second
    assert len(list((out / "entries").glob("*.json"))) == 1


@pytest.mark.slow
@pytest.mark.usefixtures("plugins")
def test_slow_explainers_get_fewer_states_and_the_output_says_so(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path
) -> None:
    ran = run_cli(
        "score", "--policy", make_bundle(), "--explainer", "all-ones", "--explainer", "slow", *QUICK,
        "--slow-episodes", 1, "--slow-timesteps", 1, "--out", out,
    )  # fmt: skip
    assert ran.code == 0, ran.err
    sizes = sorted(
        (entry.explainer.name, entry.protocol.episodes, entry.protocol.timesteps or 0)
        for _, entry in read_entries(out / "entries")
    )
    assert sizes == [("all-ones", 1, 1), ("all-ones", 2, 0), ("slow", 1, 1)]
    assert "Slow explainers (slow) had fewer states: 1 episode, at most 1 timestep of each" in ran.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--task", "blind_navigation"], ["'blind_navigation'", "blind_discovery_v0", "did you mean"]),
        (["--explainer", "attentoin"], ["'attentoin'", "attention"]),
        (["--agents", "many"], ["many"]),
        (["--agents", "0"], ["got 0"]),
        (["--agents", "65"], ["got 65", "1 to 64"]),
        (["--task", "blind_passage_v0"], ["6 entries", "gives 8"]),
        (["--episodes", "0"], ["episodes"]),
        (["--timesteps", "-1"], ["timesteps"]),
        (["--slow-timesteps", "0"], ["timesteps"]),
        (["--seed", "-1"], ["seed"]),
        (["--jobs", "0"], ["jobs"]),
        (["--behaviour-episodes", "-1"], ["behaviour_episodes"]),
        (["--no-behaviour", "atention"], ["'atention'", "did you mean 'attention'?"]),
        (["--parallel-episodes", "0"], ["parallel_episodes"]),
    ],
)
def test_invalid_options_are_refused(
    arguments: list[str], said: list[str], run_cli: RunCli, make_bundle: MakeBundle, out: Path
) -> None:
    chosen = [] if "--explainer" in arguments else ["--explainer", "attention"]
    assert_refused(run_cli("score", "--policy", make_bundle(), *chosen, *arguments, "--out", out), out, *said)


def test_an_unknown_policy_is_refused_with_the_nearest_name(
    run_cli: RunCli, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(names, "registered_policies", lambda: ({"navigation-n3": tmp_path}, []))
    ran = run_cli("score", "--policy", "navigaton-n3", "--explainer", "attention", "--out", out)
    assert_refused(ran, out, "'navigaton-n3'", "did you mean 'navigation-n3'?")
    ran = run_cli("score", "--policy", tmp_path / "nothing", "--explainer", "attention", "--out", out)
    assert_refused(ran, out, "nothing", "cannot be read")


def _truncate(folder: Path) -> None:
    path = folder / WEIGHTS
    path.write_bytes(path.read_bytes()[:-100])


def _empty(folder: Path) -> None:
    (folder / WEIGHTS).write_bytes(b"")


def _corrupt(folder: Path) -> None:
    path = folder / WEIGHTS
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(bytes(data))


def _not_finite(folder: Path) -> None:
    weights = load_file(folder / WEIGHTS)
    weights["gat.bias"] = torch.full_like(weights["gat.bias"], torch.nan)
    save_file(weights, folder / WEIGHTS)


def _other_shapes(folder: Path) -> None:
    weights = load_file(folder / WEIGHTS)
    weights["gat.bias"] = torch.zeros(3)
    save_file(weights, folder / WEIGHTS)


def _no_card(folder: Path) -> None:
    (folder / CARD).unlink()


def _broken_card(folder: Path) -> None:
    (folder / CARD).write_text("{")


def _unknown_task(folder: Path) -> None:
    path = folder / CARD
    path.write_text(path.read_text().replace("blind_navigation_v0", "blind_navigation_v9"))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (_truncate, "cannot be read as safetensors"),
        (_empty, "cannot be read as safetensors"),
        (_corrupt, "sha256"),
        (_not_finite, "NaN"),
        (_other_shapes, "gat.bias"),
        (_no_card, CARD),
        (_broken_card, "not a policy card"),
        (_unknown_task, "blind_navigation_v9"),
    ],
    ids=lambda value: value.__name__.strip("_") if callable(value) else "",
)
def test_damaged_policies_are_refused(
    damage: Callable[[Path], None], said: str, run_cli: RunCli, make_bundle: MakeBundle, out: Path
) -> None:
    folder = make_bundle()
    damage(folder)
    assert_refused(run_cli("score", "--policy", folder, "--explainer", "attention", "--out", out), out, said)


def test_two_policies_of_one_name_are_refused(run_cli: RunCli, make_bundle: MakeBundle, out: Path) -> None:
    first = make_bundle(name="same")
    second = first.rename(first.with_name("elsewhere"))
    ran = run_cli("score", "--policy", make_bundle(name="same"), "--policy", second, "--out", out)
    assert_refused(ran, out, "two policies are named 'same'")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("late-nan", "NaN"),
        ("broken", "failed to load"),
    ],
)
@pytest.mark.usefixtures("plugins")
def test_invalid_explainers_are_refused(
    name: str, said: str, run_cli: RunCli, make_bundle: MakeBundle, out: Path
) -> None:
    ran = run_cli("score", "--policy", make_bundle(), "--explainer", name, *QUICK, "--out", out)
    assert_refused(ran, out, repr(name), said)


@pytest.mark.slow
@pytest.mark.usefixtures("plugins")
def test_entries_finished_before_an_error_are_kept_and_on_the_board(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path
) -> None:
    chosen = ("--explainer", "random", "--explainer", "late-nan")
    ran = run_cli("score", "--policy", make_bundle(), *chosen, *QUICK, "--out", out)
    assert ran.code == 1
    failed, counted = ran.err.splitlines()
    assert failed.startswith("failed: late-nan on small: explainer 'late-nan' returned NaN")
    assert counted.startswith("1 of 2 failed; everything else is done.")
    (table,) = json.loads((out / "leaderboard.json").read_text())["tables"]
    (row,) = [row for row in table["policies"][0]["rows"] if row["entry_id"] is not None]
    assert row["explainer"] == "random"


@pytest.mark.usefixtures("plugins")
def test_a_policy_plugin_that_fails_to_load_is_reported(run_cli: RunCli, out: Path) -> None:
    assert_refused(run_cli("score", "--out", out, "--explainer", "random"), out, "'broken-policies'")
    assert_refused(run_cli("list", "policies"), out, "'broken-policies'")
    listed = run_cli("list", "explainers")  # runs no code, so it cannot fail on it
    assert listed.code == 0
    assert {"vandal", "broken"} <= set(listed.out.split())


def test_an_unwritable_output_folder_is_refused(
    run_cli: RunCli, make_bundle: MakeBundle, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    ran = run_cli("score", "--policy", make_bundle(), "--explainer", "random", "--out", file / "deeper")
    assert_refused(ran, file / "deeper", "cannot write")


def test_a_board_that_cannot_be_rebuilt_is_refused_before_scoring(
    run_cli: RunCli, make_bundle: MakeBundle, out: Path
) -> None:
    (out / "entries").mkdir(parents=True)
    (out / "entries" / "old.json").write_text("{}")
    ran = run_cli("score", "--policy", make_bundle(), "--explainer", "random", *QUICK, "--out", out)
    assert ran.code == 2
    assert "old.json has schema_version None" in ran.err
    assert [path.name for path in out.rglob("*.json")] == ["old.json"]


def test_list_tasks_and_explainers(run_cli: RunCli) -> None:
    tasks = json.loads(run_cli("list", "tasks", "--json").out)
    assert [task["name"] for task in tasks] == [
        "blind_navigation_v0",
        "blind_passage_v0",
        "blind_discovery_v0",
    ]
    explainers = {row["name"]: row for row in json.loads(run_cli("list", "explainers", "--json").out)}
    assert explainers["all-ones"]["kind"] == "control"
    assert explainers["gnn_explainer"]["kind"] == "explainer"
    assert "attention" in run_cli("list", "explainers").out


def test_list_policies(run_cli: RunCli, make_bundle: MakeBundle, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_bundle("blind_discovery_v0", name="mine", seed=4)
    card = json.loads((folder / CARD).read_text())
    card["performance"] = {"with_messages": {"success_rate": 0.75}}
    (folder / CARD).write_text(json.dumps(card))
    monkeypatch.setattr(names, "registered_policies", lambda: ({"mine": folder}, []))
    assert json.loads(run_cli("list", "policies", "--json").out) == [
        {
            "name": "mine",
            "task": "blind_discovery_v0",
            "n_agents": 3,
            "attention_entropy": 0.5,
            "training_seed": 4,
            "success": 0.75,
            "code": None,
        }
    ]
    assert "0.75" in run_cli("list", "policies").out


@pytest.mark.slow
def test_evaluate(run_cli: RunCli, make_bundle: MakeBundle) -> None:
    arguments = ("evaluate", "--policy", make_bundle(), *QUICK)
    (row,) = json.loads(run_cli(*arguments, "--json").out)
    assert row["policy"] == "small"
    assert row["with_messages"]["makespan"] == 6.0
    assert row["with_messages"]["reward"] != row["without_messages"]["reward"]
    lines = run_cli(*arguments, "--markdown").out.splitlines()
    assert lines[0].startswith("| policy | task | agents |")
    assert len(lines) == 3
    assert {line.count("|") for line in lines} == {lines[0].count("|")}
    assert "success" in run_cli(*arguments).out


@pytest.mark.slow
def test_the_installed_command_runs_in_its_own_process(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "xmarl_bench.cli.main", "validate", "nothing.zip"],
        capture_output=True, text=True, cwd=tmp_path, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith("xmarl-bench: nothing.zip cannot be read")
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())
