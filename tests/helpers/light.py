"""A light installation: all packages but the large ones.

`pytest --light` skips a test, or a whole file, at the import of a missing module of these, and runs all else.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

import pytest

from tests.helpers.large import LARGE

UNIX = ("fcntl", "pwd", "resource")


class Skips(MetaPathFinder):
    """Comes last, so it is asked only for modules that are missing."""

    def __init__(self, modules: Sequence[str]) -> None:
        self.modules = modules

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name in self.modules:
            pytest.skip(f"needs {name}", allow_module_level=True)
        return None


def missing(light: bool) -> Skips:
    """What tests may miss: large packages in a light installation, and on Windows the modules of Unix."""
    large = [module for modules in LARGE.values() for module in modules] if light else []
    return Skips([*large, *(UNIX if os.name == "nt" else ())])
