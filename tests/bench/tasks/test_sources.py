"""Tasks of others are found by entry point, by reference and as objects, and run only if trusted."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from tests.bench.tasks import worlds
from tests.conftest import RunCli
from xmarl_bench.errors import InputError
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.tasks import sources
from xmarl_bench.tasks.sources import known_task, open_task, task_names

HERE = "tests.bench.tasks.worlds"


@pytest.fixture(autouse=True)
def nothing_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "_opened", {})


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    named = {"mpe": "spread", "farther_v0": "Farther", "renamed": "Farther", "listed": "BAD"}
    points = [EntryPoint(name, f"{HERE}:{attribute}", sources.GROUP) for name, attribute in named.items()]
    monkeypatch.setattr(sources, "entry_points", lambda group: points if group == sources.GROUP else [])


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("task", ["mpe", f"{HERE}:spread"])
def test_a_task_s_code_does_not_run_unless_trusted(task: str, run_cli: RunCli) -> None:
    with pytest.raises(InputError, match=r"runs its own code: read it, and add --trust-code"):
        open_task(task)
    for command in (["render", "--policy", "random"], ["score", "--explainer", "self"]):
        ran = run_cli(*command, "--task", task)
        assert ran.code == 2
        assert "--trust-code" in ran.err
    listed = json.loads(run_cli("list", "tasks", "--json").out)
    assert {row["name"]: row["code"] for row in listed}["mpe"] == f"{HERE}:spread"


@pytest.mark.usefixtures("plugins")
def test_a_trusted_entry_point_is_known_by_its_name() -> None:
    with pytest.raises(InputError, match="trust-code"):
        Cell("mpe", 3)
    source = open_task("mpe", trust_code=True)
    assert (source.name, source.origin and source.origin.entry_point) == ("mpe", f"{HERE}:spread")
    assert Cell("mpe", 4).make().obs_dim == 24
    assert "mpe" in task_names()
    assert open_task("farther_v0", trust_code=True).factory is worlds.Farther


@pytest.mark.usefixtures("plugins")
def test_a_plugin_that_is_no_task_is_refused() -> None:
    with pytest.raises(InputError, match=r"'renamed' .*calls itself 'farther_v0'"):
        open_task("renamed", trust_code=True)
    with pytest.raises(InputError, match=r"'listed' .*is a dict: give a subclass"):
        open_task("listed", trust_code=True)


def test_a_reference_gives_a_task_the_name_of_its_function_or_class() -> None:
    assert open_task(f"{HERE}:spread", trust_code=True).name == "spread"
    assert open_task(f"{HERE}:Farther", trust_code=True).name == "farther_v0"
    assert known_task("spread").make(3) is known_task("spread").make(3)  # tried once
    assert open_task("spread").factory is worlds.spread  # trusted before
    assert open_task(worlds.told).name == "told"


def test_a_file_is_a_task_too(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("from tests.bench.tasks.worlds import Line\n\n\ndef mine(n):\n    return Line(n)\n")
    source = open_task(f"{file}:mine", trust_code=True)
    assert source.origin is not None
    assert source.origin.entry_point == "mine.py:mine"
    assert Cell("mine", 3).make().obs_dim == 2


@pytest.mark.parametrize(
    ("thing", "said"),
    [
        (worlds.Impostor, "has the name of a shipped task"),
        (lambda n: worlds.Line(n), "cannot be part of a file name"),
        (worlds.Line, "is a type: give a subclass of xmarl_envs.Task, or a function"),
        (f"{HERE}:nowhere", "has no 'nowhere'"),
        ("blind_navigaton_v0", "did you mean 'blind_navigation_v0'"),
    ],
)
def test_what_is_no_task_is_refused(thing: object, said: str) -> None:
    with pytest.raises(InputError, match=said):
        open_task(thing, trust_code=True)  # type: ignore[arg-type]


def test_two_entry_points_of_one_name_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("mpe", f"{HERE}:spread", sources.GROUP)
    for names in (["mpe", "mpe"], ["blind_passage_v0"]):
        points = [EntryPoint(name, point.value, point.group) for name in names]
        monkeypatch.setattr(sources, "entry_points", lambda group, points=points: points)
        with pytest.raises(InputError, match="rename one"):
            task_names()


def test_a_cell_checks_the_team_size() -> None:
    open_task(worlds.one_too_many)
    with pytest.raises(InputError, match="made a team of 4 agents, asked for 3"):
        Cell("one_too_many", 3)
    open_task(worlds.Farther)
    with pytest.raises(InputError, match="takes 1 to 64 agents, got 65"):
        Cell("farther_v0", 65)


def test_rules_that_fail_are_refused_when_a_team_is_made() -> None:
    open_task(worlds.Broken)
    with pytest.raises(
        InputError, match=r"'broken_v0' failed in its first step \(IndexError: no third goal\)"
    ):
        Cell("broken_v0", 3)
    open_task(worlds.Torn)
    with pytest.raises(InputError, match=r"shape \(3, 6\), expected \(3, 4\): name every entry"):
        Cell("torn_v0", 3)
