"""Explainers of other libraries, and code of docs/explainers.md."""

from __future__ import annotations

import importlib
import os
import re
from pathlib import Path
from typing import Any

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "explainers.md").read_text(encoding="utf-8")
BLOCKS: list[str] = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)


def library(name: str) -> Any:
    """The module. Where it is not installed, skips the test, but fails it in CI."""
    return importlib.import_module(name) if os.environ.get("CI") else pytest.importorskip(name)


def defined_in_block(with_text: str, names: dict[str, Any]) -> dict[str, Any]:
    """The names that the one block with this text defines, up to its last line that scores an entry."""
    (block,) = [block for block in BLOCKS if with_text in block]
    exec(compile(block.partition("\nentry = ")[0], "explainers.md", "exec"), names)
    return names
