"""Code in the README runs unchanged, and its ranking is the board's."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS: list[str] = re.findall(r"^```python\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)


def test_there_is_code() -> None:
    assert len(BLOCKS) >= 2
    assert "score(" in BLOCKS[0]


@pytest.mark.slow
@pytest.mark.usefixtures("short_episodes")
def test_the_example_scores(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(BLOCKS[0], "README.md", "exec"), {"__name__": "readme"})
    printed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in printed] == ["fid_plus", "fid_minus", "fid_delta", "gef"]


@pytest.mark.slow
@pytest.mark.parametrize("block", BLOCKS[1:])
def test_the_other_examples_run(block: str) -> None:
    exec(compile(block, "README.md", "exec"), {"__name__": "readme"})


def test_the_ranking_is_that_of_the_board() -> None:
    """If this fails, run docs/make_ranking.py."""
    made = runpy.run_path(str(ROOT / "docs" / "make_ranking.py"))
    assert made["page"](README, made["built"]()) == README
