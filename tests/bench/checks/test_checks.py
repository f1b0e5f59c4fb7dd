"""The common parts of all checks."""

from __future__ import annotations

import json

import pytest
import typer

from xmarl_bench.checks import Failed, Finding, NotApplicable, run_checks
from xmarl_bench.cli.check import report
from xmarl_bench.errors import InputError


def passes(number: int) -> str:
    return f"measured {number}"


def fails(number: int) -> str:
    raise Failed(f"{number} is too large: give a smaller one.")


def refused(number: int) -> str:
    raise InputError("not this one.")


def crashes(number: int) -> str:
    return str(1 / (number - number))


def does_not_apply(number: int) -> str:
    raise NotApplicable("needs a team.")


CHECKS = {"a": passes, "b": fails, "c": refused, "d": crashes, "e": does_not_apply}


def test_every_check_runs_even_if_another_fails() -> None:
    assert list(run_checks(CHECKS, 7)) == [
        Finding("a", True, "measured 7"),
        Finding("b", False, "7 is too large: give a smaller one."),
        Finding("c", False, "not this one."),
        Finding("d", False, "stopped with ZeroDivisionError: division by zero."),
        Finding("e", None, "needs a team."),
    ]


def test_only_failures_give_exit_code_1(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as stop:
        report("seven", run_checks(CHECKS, 7), as_json=False)
    assert stop.value.exit_code == 1
    printed = capsys.readouterr().out
    assert "seven: 3 of 5 checks failed." in printed
    assert "too large" in printed
    report("seven", run_checks({"a": passes, "e": does_not_apply}, 7), as_json=False)
    assert "all passed" in capsys.readouterr().out


def test_findings_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    report("seven", run_checks({"a": passes}, 7), as_json=True)
    assert json.loads(capsys.readouterr().out) == {
        "subject": "seven",
        "passed": True,
        "findings": [{"check": "a", "passed": True, "said": "measured 7"}],
    }
