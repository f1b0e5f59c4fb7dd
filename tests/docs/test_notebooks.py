"""The notebooks run unchanged, and end with a picture."""

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
def test_a_notebook_runs_and_ends_with_a_picture(path: Path) -> None:
    notebook = runpy.run_path(str(DOCS / "run_notebooks.py"))["run"](path)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(code) >= 3
    assert [out for out in code[-1].outputs if "image/png" in out.get("data", {})]
