"""Registers bundles as if a package had registered them."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from xmarl_bench.plugins import names

INSTALLED: dict[str, Path] = {}


def installed() -> dict[str, Path]:
    return INSTALLED


def install(monkeypatch: pytest.MonkeyPatch, **bundles: Path) -> None:
    """Makes these the only registered policies, and the controls the only explainers."""
    point = EntryPoint("installed", "tests.helpers.installed:installed", names.POLICIES)
    for name, bundle in bundles.items():
        monkeypatch.setitem(INSTALLED, name, bundle)
    monkeypatch.setattr(names, "entry_points", lambda group, **_: [point] if group == names.POLICIES else [])
