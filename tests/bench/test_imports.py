"""Imports follow one arrow, xmarl_baselines -> xmarl_bench -> xmarl_envs, and the API is what it says."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import xmarl_bench

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {
    "xmarl_envs": ROOT / "envs" / "xmarl_envs",
    "xmarl_bench": ROOT / "xmarl_bench",
    "xmarl_baselines": ROOT / "baselines" / "xmarl_baselines",
}
FORBIDDEN = {
    "xmarl_envs": {"torch", "torch_geometric", "stable_baselines3", "xmarl_bench", "xmarl_baselines"},
    "xmarl_bench": {"xmarl_baselines", "stable_baselines3"},
    "xmarl_baselines": set[str](),
}


def imported(source: str) -> Iterator[str]:
    """Top-level names of every package a module imports, inside functions too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_imports_follow_the_arrow(package: str) -> None:
    files = sorted(PACKAGES[package].rglob("*.py"))
    assert files
    for file in files:
        wrong = set(imported(file.read_text())) & FORBIDDEN[package]
        assert not wrong, f"{file} imports {', '.join(sorted(wrong))}"


def test_the_harness_names_no_explainer_or_policy_of_the_baselines() -> None:
    for file in PACKAGES["xmarl_bench"].rglob("*"):
        if file.suffix in (".py", ".jinja"):
            text = file.read_text()
            for name in ("xmarl_baselines", "gnn_explainer", "graphmask-pyg"):
                assert name not in text, f"{file} names {name}"


def test_the_public_api_is_there_and_lazy() -> None:
    for name in xmarl_bench.__all__:
        assert getattr(xmarl_bench, name) is not None
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = xmarl_bench.no_such_thing
    code = "import sys, xmarl_bench.errors, xmarl_bench.cli; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
