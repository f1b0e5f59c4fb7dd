"""Packages of strangers: written by `new`, built, installed into a fresh environment, scored, compared."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.bench.fresh_environment import Environment
from xmarl_bench.entry_file import read_entries
from xmarl_bench.new_package import write_package

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
    return environment


def test_both_are_found_scored_and_compared(environment: Environment) -> None:
    listed = json.loads(environment.bench("list", "explainers", "--json").stdout)
    (row,) = (row for row in listed if row["name"] == "stranger-explainer")
    assert (row["distribution"], row["version"]) == ("stranger-explainer", "0.1.0")
    assert "stranger-policy" in environment.bench("list", "policies").stdout
    scored = environment.bench(
        "score", "--policy", "stranger-policy", "--trust-code", "--explainer", "stranger-explainer",
        "--explainer", "random", *QUICK, "--out", "board",
    )  # fmt: skip
    assert scored.returncode == 0, scored.stderr
    entries = {entry.explainer.name: entry for _, entry in read_entries(environment.folder / "board/entries")}
    entry = entries["stranger-explainer"]
    assert (entry.explainer.distribution, entry.explainer.version) == ("stranger-explainer", "0.1.0")
    assert entry.explainer.entry_point == "stranger_explainer:explainer"
    assert entry.explainer.accesses == "black-box"
    assert entry.policy.trusted_code
    compared = environment.bench(
        "compare", "stranger-explainer", "random", "--entries", "board/entries", "--json",
        "--metric", "budgeted_fidelity", "--plot", "comparison.svg",
    )  # fmt: skip
    assert compared.returncode == 0, compared.stderr
    (comparison,) = json.loads(compared.stdout)
    assert [each["explainer"] for each in comparison["standings"]] == ["stranger-explainer", "random"]
    assert (environment.folder / "comparison.svg").read_text().count("<svg") == 1


@pytest.mark.parametrize("kind", ["explainer", "policy"])
def test_they_pass_their_own_tests_at_once(kind: str, environment: Environment, packages: Path) -> None:
    tested = environment.pytest(packages / kind)
    assert tested.returncode == 0, tested.stdout
    assert "2 passed" in tested.stdout


def test_one_that_does_not_import_stops_the_command_and_hides_no_other(
    packages: Path, tmp_path: Path
) -> None:
    environment = Environment.make(tmp_path / "venv")
    environment.install(packages / "explainer", packages / "broken")
    listed = environment.bench("list", "explainers")
    assert listed.returncode == 2
    assert len(listed.stderr.splitlines()) == 1
    for word in ("broken-explainer", "ModuleNotFoundError", "no_such_library"):
        assert word in listed.stderr
    assert "stranger-explainer" in listed.stdout
    everything = environment.bench("score", "--explainer", "all", *QUICK, "--out", "board")
    assert everything.returncode == 2
    assert "broken-explainer" in everything.stderr
    assert not (environment.folder / "board").exists()
