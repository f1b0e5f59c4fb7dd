"""The documentation site: every document is a page, no link of it leads nowhere, and it builds."""

from __future__ import annotations

import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAKE = ROOT / "docs" / "make_site.py"
SITE = runpy.run_path(str(MAKE))


def test_every_document_is_a_page() -> None:
    documents = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("[a-z]*/README.md")]
    assert sorted(SITE["pages"]()) == sorted(path.relative_to(ROOT).as_posix() for path in documents)


def test_links_of_pages_lead_to_pages_and_pictures(tmp_path: Path) -> None:
    SITE["collect"](tmp_path)
    texts = {page: page.read_text(encoding="utf-8") for page in tmp_path.rglob("*.md")}
    assert len(texts) == len(SITE["pages"]())
    links = [(page, link) for page, text in texts.items() for link in SITE["LINK"].finditer(text)]
    assert len(links) > 20
    for page, link in links:
        assert (page.parent / link.group(3)).is_file(), (page, link.group())
    start = texts[tmp_path / "README.md"]
    assert "](docs/explanation.png)" in start
    assert "](docs/notebooks" not in start  # no page, so its link becomes text


@pytest.mark.slow
@pytest.mark.skipif(find_spec("material") is None, reason="needs the extra docs; CI has a job for it")
def test_the_site_builds_and_can_be_searched(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, MAKE, tmp_path / "site"], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    index = (tmp_path / "site" / "search" / "search_index.json").read_text(encoding="utf-8")
    assert "message fidelity" in index
