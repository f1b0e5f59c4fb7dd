"""Imports go one way: xmarl_baselines -> xmarl_bench -> xmarl_envs, and one way inside xmarl_bench."""

from __future__ import annotations

import ast
import functools
from graphlib import TopologicalSorter
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

# Layers of xmarl_bench, lowest first: a package imports only from lower layers or from itself.
LAYERS = (
    ("counted", "errors"),
    ("metrics", "origin", "records", "reproducible"),
    ("parallel", "policy", "tasks"),
    ("entry", "explain", "planted", "rollout"),
    ("board", "checks", "compare", "dataset", "isolation"),
    ("plugins",),
    ("scoring",),
    ("meta", "papers", "render", "submission"),
    ("cli",),
)


@pytest.mark.parametrize("package", ALLOWED, ids=lambda package: package.__name__)
def test_a_package_imports_only_what_is_below_it(package: ModuleType) -> None:
    folder = Path(str(package.__file__)).parent
    files = list(folder.rglob("*.py"))
    assert files
    for file in files:
        ours = {name for name in imported(file) if name.startswith("xmarl_")}
        assert ours <= ALLOWED[package], file


def test_packages_of_the_harness_import_only_from_lower_layers() -> None:
    folder = Path(str(xmarl_bench.__file__)).parent
    layer_of = {name: layer for layer, names in enumerate(LAYERS) for name in names}
    here = {path.stem for path in folder.iterdir() if (path / "__init__.py").exists() or path.suffix == ".py"}
    assert here - {"__init__"} == set(layer_of)
    for file in folder.rglob("*.py"):
        own = file.relative_to(folder).parts[0].removesuffix(".py")
        if own == "__init__":
            continue
        for name in modules_imported(file):
            top, _, rest = name.partition(".")
            other = rest.partition(".")[0]
            if top == "xmarl_bench" and other != own:
                assert layer_of[other] < layer_of[own], f"{file} imports {name}"


@pytest.mark.parametrize("package", [xmarl_bench, xmarl_baselines], ids=lambda package: package.__name__)
def test_no_two_files_import_each_other(package: ModuleType) -> None:
    """Not even inside functions or through other files. An `__init__` stands for the files it names."""
    root = Path(str(package.__file__)).parent.parent
    files = {module_of(file, root): file for file in (root / package.__name__).rglob("*.py")}
    faces = {name: names_handed_on(file) for name, file in files.items() if file.stem == "__init__"}
    assert len(files) > 30
    arrows: dict[str, set[str]] = {}
    for name, file in files.items():
        if name not in faces:
            arrows[name] = {
                f"{module}.{each}" if f"{module}.{each}" in files else faces.get(module, {}).get(each, module)
                for module, each in names_taken(file)
            }
    TopologicalSorter(arrows).prepare()  # raises CycleError with the files of a circle


def module_of(file: Path, root: Path) -> str:
    return ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


@functools.cache
def import_statements(file: Path) -> list[ast.Import | ast.ImportFrom]:
    """All of a file, also inside functions."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


def names_taken(file: Path) -> set[tuple[str, str]]:
    """(module, name) of every `from module import name` of a file, also inside functions."""
    return {
        (node.module, alias.name)
        for node in import_statements(file)
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module
        for alias in node.names
    }


def names_handed_on(face: Path) -> dict[str, str]:
    """Name -> the module that an `__init__.py` takes it from."""
    return {name: module for module, name in names_taken(face)}


def modules_imported(file: Path) -> set[str]:
    """Full names of all modules that a file imports from, also inside functions."""
    plain = {
        alias.name for node in import_statements(file) if isinstance(node, ast.Import) for alias in node.names
    }
    taken = names_taken(file)
    return plain | {f"{module}.{name}" if module == "xmarl_bench" else module for module, name in taken}


def imported(file: Path) -> set[str]:
    """The top-level names of all imports of a file, also inside functions."""
    return {name.split(".")[0] for name in modules_imported(file)}


def test_the_environments_need_no_learning_library() -> None:
    """Only the adapter for stable-baselines3 imports it, and nothing imports that adapter."""
    face = "sb3_vec_env"
    for file in Path(str(xmarl_envs.__file__)).parent.rglob("*.py"):
        assert not imported(file) & {"torch", "torch_geometric"}, file
        if file.stem != face:
            assert "stable_baselines3" not in imported(file), file
            assert f"xmarl_envs.{face}" not in file.read_text(encoding="utf-8"), file
