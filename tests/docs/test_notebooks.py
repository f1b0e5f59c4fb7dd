"""The notebooks run unchanged but for the length of a training, and end with a picture."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks() -> None:
    assert "own_explainer" in [path.stem for path in NOTEBOOKS]


@pytest.mark.slow
@pytest.mark.usefixtures("needs_torch")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_ends_with_a_picture(path: Path, tmp_path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    assert ("iteration in range(81)" in source) == (path.stem == "own_task")
    copy = tmp_path / path.name
    copy.write_text(source.replace("iteration in range(81)", "iteration in range(2)"), encoding="utf-8")
    notebook = runpy.run_path(str(DOCS / "run_notebooks.py"))["run"](copy)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(code) >= 3
    assert [out for out in code[-1].outputs if "image/png" in out.get("data", {})]
