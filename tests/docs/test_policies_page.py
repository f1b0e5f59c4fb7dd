"""docs/policies.md: its examples run, and what it says is bounded is bounded so."""

from __future__ import annotations

import json
import re
from pathlib import Path

from xmarl_bench import load_policy
from xmarl_bench.policy.architecture import MAX_LAYER_WIDTH
from xmarl_bench.policy.convert import rename
from xmarl_bench.policy.shapes import MAX_PARAMETERS

PAGE = (Path(__file__).parents[2] / "docs" / "policies.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)


def test_the_bundle_of_the_page_is_made(tmp_path: Path) -> None:
    exec(compile(blocks("python")[0], "policies.md", "exec"), {"folder": tmp_path})
    policy, card = load_policy(tmp_path)
    assert card.name == "mine"
    assert not policy.row_wise


def test_the_key_map_of_the_page_is_one() -> None:
    (text,) = blocks("json")
    assert rename({}, json.loads(text)) == {}


def test_bounds_are_those_of_the_code() -> None:
    assert f"{MAX_PARAMETERS:,} parameters" in PAGE
    assert f"together at most {MAX_LAYER_WIDTH}" in PAGE
