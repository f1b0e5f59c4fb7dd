"""Registers bundles as if a package had registered them."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from xmarl_bench.plugins import registry

INSTALLED: dict[str, Path] = {}


def installed() -> dict[str, Path]:
    return INSTALLED


def install(monkeypatch: pytest.MonkeyPatch, **bundles: Path) -> None:
    """Makes these the only registered policies, and the controls the only explainers."""
    point = EntryPoint("installed", "tests.helpers.installed:installed", registry.POLICIES)
    for name, bundle in bundles.items():
        monkeypatch.setitem(INSTALLED, name, bundle)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point] if group == registry.POLICIES else [])
