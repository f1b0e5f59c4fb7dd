"""Third-party packages: written by `new`, built, installed into a fresh environment, scored, compared."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.conftest import Ran
from tests.helpers.forks import Ask, forks
from tests.helpers.fresh_environment import Environment
from tests.helpers.zygote import Request
from xmarl_bench.entry.file import read_entries
from xmarl_bench.plugins.new_package import write_package

pytestmark = pytest.mark.slow
QUICK = ("--episodes", 2, "--timesteps", 5, "--max-cycles", 20, "--behaviour-episodes", 0)


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("packages")
    write_package("explainer", "stranger-explainer", folder / "explainer")
    write_package("policy", "stranger-policy", folder / "policy")
    write_package("explainer", "broken-explainer", folder / "broken")
    (folder / "broken/src/broken_explainer/__init__.py").write_text("import no_such_library\n")
    return folder


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory, packages: Path) -> Environment:
    environment = Environment.make(tmp_path_factory.mktemp("environment") / "venv")
    environment.install(packages / "explainer", packages / "policy")
    environment.install(packages / "broken", target=environment.folder / "broken")
    return environment


Run = Callable[..., Ran]


@pytest.fixture(scope="module")
def ask(environment: Environment) -> Iterator[Ask]:
    with forks(environment.python) as ask:
        yield ask


@pytest.fixture
def run(ask: Ask, tmp_path: Path) -> Run:
    """run(program, argument, ..., site=folder) -> the result of the program, run in an empty folder."""

    def run(*command: object, site: Path | None = None) -> Ran:
        request: Request = {"command": [str(word) for word in command], "folder": str(tmp_path)}
        if site is not None:
            request["site"] = str(site)
        done = ask(request)
        return Ran(done["code"], done["out"], done["err"])

    return run


def test_new_explainers_and_policies_are_listed_scored_and_compared(run: Run, tmp_path: Path) -> None:
    listed = json.loads(run("xmarl-bench", "list", "explainers", "--json").out)
    (row,) = (row for row in listed if row["name"] == "stranger-explainer")
    assert (row["distribution"], row["version"]) == ("stranger-explainer", "0.1.0")
    assert "stranger-policy" in run("xmarl-bench", "list", "policies").out
    scored = run(
        "xmarl-bench", "score", "--policy", "stranger-policy", "--trust-code",
        "--explainer", "stranger-explainer", "--explainer", "random", *QUICK, "--out", "board",
    )  # fmt: skip
    assert scored.code == 0, scored.err
    entries = {entry.explainer.name: entry for _, entry in read_entries(tmp_path / "board/entries")}
    entry = entries["stranger-explainer"]
    assert (entry.explainer.distribution, entry.explainer.version) == ("stranger-explainer", "0.1.0")
    assert entry.explainer.entry_point == "stranger_explainer:explainer"
    assert entry.explainer.accesses == "black-box"
    assert entry.policy.trusted_code
    compared = run(
        "xmarl-bench", "compare", "stranger-explainer", "random", "--entries", "board/entries", "--json",
        "--metric", "budgeted_fidelity", "--plot", "comparison.svg",
    )  # fmt: skip
    assert compared.code == 0, compared.err
    (comparison,) = json.loads(compared.out)
    assert [each["explainer"] for each in comparison["standings"]] == ["stranger-explainer", "random"]
    assert (tmp_path / "comparison.svg").read_text().count("<svg") == 1


@pytest.mark.parametrize("kind", ["explainer", "policy"])
def test_new_packages_pass_their_own_tests(kind: str, run: Run, packages: Path) -> None:
    tested = run("pytest", "-q", "-p", "no:cacheprovider", packages / kind)
    assert tested.code == 0, tested.out
    assert "2 passed" in tested.out


def test_a_package_that_fails_to_import_is_reported_and_does_not_hide_the_others(
    environment: Environment, run: Run, tmp_path: Path
) -> None:
    broken = environment.folder / "broken"
    listed = run("xmarl-bench", "list", "explainers", site=broken)
    assert listed.code == 0  # a list runs nothing
    assert {"stranger-explainer", "broken-explainer"} <= set(listed.out.split())
    scored = run(
        "xmarl-bench", "score", "--policy", "stranger-policy", "--trust-code", "--explainer",
        "broken-explainer", "--explainer", "random", *QUICK, "--out", "board", site=broken,
    )  # fmt: skip
    assert scored.code == 1
    for word in ("failed: ", "broken-explainer", "ModuleNotFoundError", "no_such_library", "1 of 2 failed"):
        assert word in scored.err
    assert [entry.explainer.name for _, entry in read_entries(tmp_path / "board/entries")] == ["random"]
