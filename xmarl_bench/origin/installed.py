"""What is installed: versions of distributions, and which of them a module belongs to."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version


def package_version(name: str) -> str | None:
    """Of a distribution; None if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def distribution_of(module: str) -> str | None:
    """The installed package that a module is of, by its top-level name."""
    return next(iter(_distributions().get(module.split(".")[0], [])), None)


@cache
def _distributions() -> Mapping[str, list[str]]:
    return packages_distributions()
