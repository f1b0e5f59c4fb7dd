"""Third-party packages: written by `new`, built, installed into a fresh environment, scored, compared."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.conftest import Ran
from tests.helpers.forks import Ask, forks
from tests.helpers.fresh_environment import Environment
from xmarl_bench.entry.file import read_entries
from xmarl_bench.plugins.new_package import write_package

pytestmark = pytest.mark.slow
EXPLAINER, POLICY = "stranger-explainer", "stranger-policy"
QUICK = ("--episodes", 2, "--timesteps", 5, "--max-cycles", 20, "--behaviour-episodes", 0)


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("packages")
    write_package("explainer", EXPLAINER, folder / "explainer")
    write_package("policy", POLICY, folder / "policy")
    write_package("explainer", "broken-explainer", folder / "broken")
    (folder / "broken/src/broken_explainer/__init__.py").write_text("import no_such_library\n")
    return folder


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory, packages: Path) -> Environment:
    environment = Environment.make(tmp_path_factory.mktemp("environment") / "venv")
    environment.install(*packages.iterdir())
    return environment


Run = Callable[..., Ran]


@pytest.fixture(scope="module")
def ask(environment: Environment) -> Iterator[Ask]:
    with forks(environment.python) as ask:
        yield ask


@pytest.fixture
def run(ask: Ask, tmp_path: Path) -> Run:
    """run(program, argument, ...) -> the result of the program, run in an empty folder."""

    def run(*command: object) -> Ran:
        done = ask({"command": [str(word) for word in command], "folder": str(tmp_path)})
        return Ran(done["code"], done["out"], done["err"])

    return run


def test_new_packages_are_listed_scored_and_compared_beside_one_that_fails_to_import(
    run: Run, tmp_path: Path
) -> None:
    listed = run("xmarl-bench", "list", "explainers", "--json")  # runs no package's code
    assert listed.code == 0, listed.err
    rows = {row["name"]: row for row in json.loads(listed.out)}
    assert "broken-explainer" in rows
    assert (rows[EXPLAINER]["distribution"], rows[EXPLAINER]["version"]) == (EXPLAINER, "0.1.0")
    assert POLICY in run("xmarl-bench", "list", "policies").out
    scored = run(
        "xmarl-bench", "score", "--policy", POLICY, "--trust-code", "--explainer", "broken-explainer",
        "--explainer", EXPLAINER, "--explainer", "random", *QUICK, "--out", "board",
    )  # fmt: skip
    assert scored.code == 1
    for word in ("failed: ", "broken-explainer", "ModuleNotFoundError", "no_such_library", "1 of 3 failed"):
        assert word in scored.err
    entries = {entry.explainer.name: entry for _, entry in read_entries(tmp_path / "board/entries")}
    assert entries.keys() == {EXPLAINER, "random"}
    entry = entries[EXPLAINER]
    assert (entry.explainer.distribution, entry.explainer.version) == (EXPLAINER, "0.1.0")
    assert entry.explainer.entry_point == "stranger_explainer:explainer"
    assert entry.explainer.accesses == "black-box"
    assert entry.policy.trusted_code
    compared = run(
        "xmarl-bench", "compare", EXPLAINER, "random", "--entries", "board/entries", "--json",
        "--metric", "budgeted_fidelity", "--plot", "comparison.svg",
    )  # fmt: skip
    assert compared.code == 0, compared.err
    (comparison,) = json.loads(compared.out)
    assert [each["explainer"] for each in comparison["standings"]] == [EXPLAINER, "random"]
    assert (tmp_path / "comparison.svg").read_text().count("<svg") == 1


def test_new_packages_pass_their_own_tests(run: Run, packages: Path) -> None:
    tested = run("pytest", "-q", "-p", "no:cacheprovider", packages / "explainer", packages / "policy")
    assert tested.code == 0, tested.out
    assert "4 passed" in tested.out
