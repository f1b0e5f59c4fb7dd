"""The explainers that pyproject.toml registers, however old the installation is that runs the tests."""

from __future__ import annotations

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.plugins.registry import EXPLAINERS

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def shipped_plugins() -> list[EntryPoint]:
    """By name."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    named: dict[str, str] = project["entry-points"][EXPLAINERS]
    return [EntryPoint(name, where, EXPLAINERS) for name, where in sorted(named.items())]


def shipped_explainers() -> list[Explainer]:
    return [plugin.load() for plugin in shipped_plugins()]
