"""Installed distributions: their versions, which one a module belongs to, and which code is the user's."""

from __future__ import annotations

import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path

HARNESS = ("xmarl_bench", "xmarl_envs")
INSTALLED = {"site-packages", "dist-packages"}
_distributions = cache(packages_distributions)


def package_version(name: str) -> str | None:
    """The version of a distribution; None if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def harness_version() -> str:
    """The version of this package; "unknown" if it runs without being installed."""
    return package_version("xmarl-bench") or "unknown"


def distribution_of(module: str) -> str | None:
    """The distribution that a module belongs to, by its top-level name; None if it is not installed."""
    return next(iter(_distributions().get(module.split(".")[0], [])), None)


def is_own(module: str) -> bool:
    """Whether a module is the user's own code: outside site-packages, so editable installs count too.

    Imports nothing.
    """
    top = module.partition(".")[0]
    if top in HARNESS or top in sys.stdlib_module_names:
        return False
    return not any(INSTALLED & set(place.parts) for place in places_of(module))


def places_of(module: str) -> list[Path]:
    """The folders of a loaded top-level package, or its file; empty for code typed into an interpreter."""
    top = sys.modules.get(module.partition(".")[0])
    file = getattr(top, "__file__", None)
    folders = [*getattr(top, "__path__", [])]
    return [Path(each) for each in folders or ([] if file is None else [file])]
