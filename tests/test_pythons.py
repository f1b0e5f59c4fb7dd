"""A light installation needs no large package, and tests that need one are skipped there and nowhere else."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires

import pytest

from tests.helpers.large import LARGE
from tests.helpers.light import missing
from tests.pythons import ROOT, light_requirements, requirements


def name_of(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement, maxsplit=1)[0].lower().replace("_", "-")


def needed_by(distribution: str, seen: set[str]) -> Iterator[str]:
    """What a distribution brings along, as far as it is installed here."""
    if distribution in seen:
        return
    seen.add(distribution)
    yield distribution
    try:
        requirements = requires(distribution) or []
    except PackageNotFoundError:
        return
    for requirement in requirements:
        if "extra ==" not in requirement:
            yield from needed_by(name_of(requirement), seen)


def test_a_light_installation_brings_no_large_package() -> None:
    seen: set[str] = set()
    brought = {name for each in light_requirements() for name in needed_by(name_of(each), seen)}
    assert {"numpy", "gymnasium", "annotated-types"} <= brought
    assert not brought & set(LARGE)


def test_only_a_light_run_skips_at_the_import_of_a_large_package() -> None:
    with pytest.raises(pytest.skip.Exception, match="needs torch"):
        missing(light=True).find_spec("torch")
    assert missing(light=True).find_spec("numpy") is None
    assert missing(light=False).find_spec("torch") is None


def test_the_lowest_versions_are_the_lower_bounds() -> None:
    """If it fails, write these lines to constraints-lowest.txt, and run `make test-lowest`."""
    lines = (ROOT / "constraints-lowest.txt").read_text(encoding="utf-8").splitlines()
    bounds = [re.sub(r"[>=]=([^,]*).*", r"==\1", each) for each in requirements()]
    assert [line for line in lines if not line.startswith("#")] == sorted(bounds)
