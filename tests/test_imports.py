"""Imports follow one arrow: xmarl_baselines -> xmarl_bench -> xmarl_envs."""

from __future__ import annotations

import ast
from pathlib import Path
from types import ModuleType

import pytest
import xmarl_baselines
import xmarl_envs

import xmarl_bench

ALLOWED = {
    xmarl_envs: {"xmarl_envs"},
    xmarl_bench: {"xmarl_envs", "xmarl_bench"},
    xmarl_baselines: {"xmarl_envs", "xmarl_bench", "xmarl_baselines"},
}


@pytest.mark.parametrize("package", ALLOWED, ids=lambda package: package.__name__)
def test_a_package_imports_only_what_is_below_it(package: ModuleType) -> None:
    folder = Path(str(package.__file__)).parent
    files = list(folder.rglob("*.py"))
    assert files
    for file in files:
        ours = {name for name in imported(file) if name.startswith("xmarl_")}
        assert ours <= ALLOWED[package], file


def imported(file: Path) -> set[str]:
    """The top-level names of all imports of a file, inside functions too."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.split(".")[0])
    return names


def test_the_environments_need_no_learning_library() -> None:
    """Nothing but the face for stable-baselines3 imports it, and nothing imports that face."""
    face = "sb3_vec_env"
    for file in Path(str(xmarl_envs.__file__)).parent.rglob("*.py"):
        assert not imported(file) & {"torch", "torch_geometric"}, file
        if file.stem != face:
            assert "stable_baselines3" not in imported(file), file
            assert f"xmarl_envs.{face}" not in file.read_text(encoding="utf-8"), file
