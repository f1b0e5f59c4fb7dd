"""A result's key follows the code that it comes from, and no other."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from xmarl_bench.scoring import source_code as module
from xmarl_bench.scoring.content_key import COMPUTED_BY
from xmarl_bench.scoring.source_code import source_sha256

FILES = {
    "__init__.py": "",
    "top.py": "from shop.middle import f\n",
    "middle.py": "from . import deep\nimport json\n\n\ndef f():\n    return deep.VALUE\n",
    "deep.py": "VALUE = 1\n",
    "beside.py": "VALUE = 1\n",
}


@pytest.fixture
def shop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "shop"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [each for each in sys.modules if each.split(".")[0] == "shop"]:
        del sys.modules[name]


def digest(module: str = "shop.top") -> str | None:
    source_sha256.cache_clear()
    return source_sha256(module)


def test_code_at_second_hand_counts(shop: Path) -> None:
    before = digest()
    assert before is not None
    (shop / "deep.py").write_text("VALUE = 2\n")
    after = digest()
    assert after != before
    (shop / "beside.py").write_text("VALUE = 2\n")
    assert digest() == after


def test_words_and_layout_do_not_count(shop: Path) -> None:
    before = digest()
    (shop / "middle.py").write_text(
        '"""A docstring."""\nfrom . import deep\nimport json\n\ndef f():\n    """Another."""\n'
        "    return deep.VALUE  # a comment\n"
    )
    assert digest() == before
    (shop / "middle.py").write_text("from . import deep\nimport json\ndef f():\n    return 'deep.VALUE'\n")
    assert digest() != before  # a text that is returned is code


def test_what_has_no_source_has_no_hash(shop: Path) -> None:
    assert digest("shop.nothing") is None
    assert digest("math") is None


def test_the_harness_is_all_that_a_worker_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    code = f"import sys\n{chr(10).join(f'import {name}' for name in COMPUTED_BY)}\nprint(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    ours = {name for name in loaded.split() if name.split(".")[0] in ("xmarl_bench", "xmarl_envs")}
    found: set[str] = set()
    original = module._source

    def spy(name: str) -> bytes | None:
        source = original(name)
        if source is not None:
            found.add(name)
        return source

    monkeypatch.setattr(module, "_source", spy)
    source_sha256.cache_clear()
    assert source_sha256(*COMPUTED_BY) is not None
    source_sha256.cache_clear()
    assert ours - found <= {"xmarl_bench"}  # what `import xmarl_bench` offers is for users
    assert not found & {"xmarl_bench.cli.tables", "xmarl_bench.board", "xmarl_bench.metrics.statistics"}
