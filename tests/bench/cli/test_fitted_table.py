"""Tables in narrow terminals: nothing is cut, and the name and the headline stay."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import typer.main
import xmarl_baselines
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

import xmarl_bench
from tests.conftest import MakeBundle, RunCli
from tests.helpers.made_entries import made_entry
from xmarl_bench.cli import fitted_table, score_table
from xmarl_bench.cli.fitted_table import TEXT, fit, print_table
from xmarl_bench.cli.main import app
from xmarl_bench.counted import counted
from xmarl_bench.entry.file import write_entry
from xmarl_bench.meta import planted_suite
from xmarl_bench.meta.planted_suite import score_planted

WIDTHS = (80, 60)
Columns = dict[str, str]


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """terminal(width): from now on output goes to a terminal of this width."""

    def of_width(width: int) -> None:
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("COLUMNS", str(width))

    return of_width


def tables(printed: str) -> list[Columns]:
    """Heading -> all its cells in one string, without spaces, for each table that was printed."""
    found: list[Columns] = []
    headings: list[str] = []
    cells: list[str] = []
    for line in _plain(printed).splitlines():
        parts = ["".join(part.split()) for part in re.split("[┃│]", line)[1:-1]]
        if line.startswith("┏"):
            headings, cells = [], []
        elif line.startswith("┃"):
            headings = [a + b for a, b in zip(headings or [""] * len(parts), parts, strict=True)]
        elif line.startswith("│"):
            cells = [a + b for a, b in zip(cells or [""] * len(parts), parts, strict=True)]
        elif line.startswith("└"):
            found.append(dict(zip(headings, cells, strict=True)))
    return found


def commands(make_bundle: MakeBundle, folder: Path) -> list[tuple[list[str], tuple[object, ...]]]:
    """The headlines of a command's tables, which have to stay, and the command."""
    bundle = make_bundle(name="passage-n3-residual-lambda0.04-seed0")
    quick = ("--episodes", 2, "--max-cycles", 3)
    for explainer, level in (("integrated_gradients-messages", 0.9), ("gnn_explainer-messages", 0.2)):
        write_entry(folder / "entries", made_entry("made", explainer, level))
    return [
        (["maxagents"], ("list", "tasks")),
        (["success"], ("list", "policies")),
        (["summary"], ("list", "explainers")),
        (["success"], ("evaluate", "--policy", bundle, *quick)),
        (["messagefidelity"], (
            "score", "--policy", bundle, "--explainer", "integrated_gradients-messages", *quick,
            "--no-behaviour", "all", "--out", folder / "scores",
        )),
        (["mean", "difference"], ("compare", folder / "entries")),
        (["AUROC"], ("score", "--suite", "planted", "--explainer", "attention", "--out", folder)),
        (["finding"], ("check", "task", "blind_discovery_v0", "--episodes", 2)),
        (["shape"], ("convert", bundle / "policy.safetensors")),
    ]  # fmt: skip


@pytest.mark.slow
def test_no_table_of_any_command_is_cut(
    run_cli: RunCli,
    make_bundle: MakeBundle,
    tmp_path: Path,
    terminal: Callable[[int], None],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a command prints in narrow terminals is what it prints in a wide one, without the last columns."""
    seen: list[dict[int, str]] = []
    real = fitted_table.print_tables

    def in_every_width(*arguments: Any, **options: Any) -> None:
        seen.append({})
        for width in (1000, *WIDTHS):
            capsys.readouterr()
            terminal(width)
            real(*arguments, **options)
            seen[-1][width] = _plain(capsys.readouterr().out)

    for module in (fitted_table, score_table):
        monkeypatch.setattr(module, "print_tables", in_every_width)
    monkeypatch.setattr(planted_suite, "score_planted", partial(score_planted, sizes=[3], n_steps=4))
    for headlines, command in commands(make_bundle, tmp_path):
        seen.clear()
        ran = run_cli(*command)
        assert len(seen) == len(headlines), (command, ran.err)
        for headline, printed in zip(headlines, seen, strict=True):
            wide = tables(printed.pop(1000))
            for width, text in printed.items():
                narrow = tables(text)
                for whole, fitted in zip(wide, narrow, strict=True):
                    assert fitted.items() <= whole.items()
                    assert {next(iter(whole)), headline} <= fitted.keys()
                assert "…" not in text
                assert max(map(cell_len, text.splitlines())) <= width
                assert ("A wider terminal also shows" in text) == (narrow != wide)


def _plain(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


def test_tables_are_made_in_one_place() -> None:
    packages = [Path(str(package.__file__)).parent for package in (xmarl_bench, xmarl_baselines)]
    ours = Path(str(fitted_table.__file__))
    for file in (each for package in packages for each in package.rglob("*.py") if each != ours):
        assert "rich.table" not in file.read_text(encoding="utf-8"), file


def test_columns_that_fit_by_hand() -> None:
    columns = {"name": ["a" * 10], "value": ["0.123"], "more": ["9 / 9"], "why": ["words " * 20]}
    # Lines and spaces take 1 + 3 per column.
    assert fit(columns, 1000) == {"name": 10, "value": 5, "more": 5, "why": 120}
    assert fit(columns, 13 + 10 + 5 + 5 + TEXT + 7) == {"name": 10, "value": 5, "more": 5, "why": TEXT + 7}
    assert fit(columns, 10 + 10 + 5 + 5 + TEXT) == {"name": 10, "value": 5, "more": 5}
    assert fit(columns, 10 + 10 + 5 + TEXT, keep=["why"]) == {"name": 10, "value": 5, "why": TEXT}
    assert fit(columns, 20) == {"name": 20 - 7 - 5, "value": 5}  # the name is folded, the number is whole


@given(
    names=st.lists(st.text("abc_-", min_size=1, max_size=100), min_size=1, max_size=4),
    n_columns=st.integers(1, 6),
    size=st.integers(1, 12),
    width=st.integers(20, 200),
)
def test_numbers_stay_whole_in_every_width(names: list[str], n_columns: int, size: int, width: int) -> None:
    columns = {"name": names} | {f"n{k}": ["1" * size] * len(names) for k in range(n_columns)}
    widths = fit(columns, width)
    assert list(widths) == list(columns)[: len(widths)]
    assert len(widths) >= 2
    assert all(widths[each] >= size for each in widths if each != "name")
    if width >= 8 + size + 2:
        assert 1 + sum(each + 3 for each in widths.values()) <= width


def test_text_is_printed_as_it_is(
    capsys: pytest.CaptureFixture[str], terminal: Callable[[int], None]
) -> None:
    """Brackets are no markup, and a name of 100 characters is whole."""
    terminal(80)
    print_table([{"name": "n" * 100, "value": 0.1234, "why": "[bold]x[/bold]"}], title="[red]t[/red]")
    out = capsys.readouterr().out
    (table,) = tables(out)
    assert table == {"name": "n" * 100, "value": "0.123", "why": "[bold]x[/bold]"}
    assert "[red]t[/red]" in _plain(out)


@pytest.mark.parametrize("name", ["score", "study", "evaluate", "verify", "convert", "render", "compare"])
def test_help_is_not_cut(run_cli: RunCli, name: str, terminal: Callable[[int], None]) -> None:
    terminal(80)
    assert "…" not in run_cli(name, "--help").out


def test_options_of_score_are_grouped() -> None:
    command = typer.main.get_command(app)
    assert isinstance(command, typer.core.TyperGroup)
    groups: dict[str, list[str]] = {}
    for option in command.commands["score"].params:
        groups.setdefault(getattr(option, "rich_help_panel", None) or "other", []).append(option.name or "")
    assert list(groups) == ["What", "How much", "Processes and cluster", "Where results go"]


@pytest.mark.parametrize(
    ("number", "noun", "text"),
    [(0, "entry", "0 entries"), (1, "entry", "1 entry"), (2, "agent", "2 agents"), (1, "agent", "1 agent")],
)
def test_plural_forms(number: int, noun: str, text: str) -> None:
    assert counted(number, noun) == text
