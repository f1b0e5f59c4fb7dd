"""The files that `new` writes; test_installed_plugins.py installs and scores them."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.conftest import RunCli
from xmarl_bench.plugins.new_package import TEMPLATES

CONFIG = Path(__file__).parents[3] / "pyproject.toml"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["explainer", "policy"])
def test_files_are_complete_and_valid(kind: str, run_cli: RunCli, tmp_path: Path) -> None:
    folder = tmp_path / "package"
    ran = run_cli("new", kind, "brand-new.one", "--out", folder)
    assert ran.code == 0, ran.err
    written = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    modules = ["__init__.py", "network.py"] if kind == "policy" else ["__init__.py"]
    assert written == [
        "README.md", "pyproject.toml", *(f"src/brand_new_one/{module}" for module in modules),
        "tests/test_brand_new_one.py",
    ]  # fmt: skip
    assert len(written) == len(list((TEMPLATES / kind).rglob("*.jinja")))
    for path in written:
        assert str(folder / path) in ran.out
        assert "{{" not in (folder / path).read_text()
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    (points,) = project["entry-points"].values()
    assert [value.split(":")[0] for value in points.values()] == ["brand_new_one"]
    for check in ("check", "format --check"):
        command = [sys.executable, "-m", "ruff", *check.split(), "--config", str(CONFIG), str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("explainer", "attention"),
        ("explainer", "all-ones"),
        ("policy", "navigation-n3-residual-lambda0-seed0"),
    ],
)
def test_names_of_installed_ones_are_refused(kind: str, name: str, run_cli: RunCli, tmp_path: Path) -> None:
    ran = run_cli("new", kind, name, "--out", tmp_path / "package")
    assert (ran.code, ran.out) == (2, "")
    assert ran.err == f"xmarl-bench: an installed {kind} is named {name!r}: choose another name.\n"
    assert not (tmp_path / "package").exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("1st", "is not a valid package name"),
        ("My-Own", "is not a valid package name"),
        ("../elsewhere", "is not a valid package name"),
        ("class", "is not a valid package name"),
        ("torch", "already installed"),
        ("json", "already installed"),
    ],
)
def test_invalid_names_are_refused(name: str, said: str, run_cli: RunCli, tmp_path: Path) -> None:
    ran = run_cli("new", "explainer", name, "--out", tmp_path / "package")
    assert (ran.code, ran.out, len(ran.err.splitlines())) == (2, "", 1)
    assert said in ran.err
    assert not (tmp_path / "package").exists()


def test_existing_files_are_not_overwritten(run_cli: RunCli, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    ran = run_cli("new", "policy", "brand-new", "--out", tmp_path)
    assert ran.code == 2
    assert "already exists" in ran.err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
