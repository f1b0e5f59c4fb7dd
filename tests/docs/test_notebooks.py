"""The notebooks run unchanged but for the length of a training, and end with a picture."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from jupyter_client.manager import KernelManager

DOCS = Path(__file__).parents[2] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks() -> None:
    assert "own_explainer" in [path.stem for path in NOTEBOOKS]


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[KernelManager]:
    """One kernel for all notebooks, which imports torch once."""
    from jupyter_client.manager import start_new_kernel

    manager, client = start_new_kernel(startup_timeout=600, cwd=str(tmp_path_factory.mktemp("notebooks")))
    client.stop_channels()
    yield manager
    manager.shutdown_kernel()


@pytest.mark.slow
@pytest.mark.usefixtures("needs_torch")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_ends_with_a_picture(path: Path, kernel: KernelManager, tmp_path: Path) -> None:
    import nbformat

    notebook = nbformat.read(path, as_version=4)
    training = [cell for cell in notebook.cells if "iteration in range(81)" in cell.source]
    assert len(training) == (path.stem == "own_task")
    for cell in training:
        cell.source = cell.source.replace("iteration in range(81)", "iteration in range(2)")
    notebook.cells.insert(0, nbformat.v4.new_code_cell("%reset -f"))  # names of the notebook before
    nbformat.write(notebook, tmp_path / path.name)
    notebook = runpy.run_path(str(DOCS / "run_notebooks.py"))["run"](tmp_path / path.name, kernel)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(code) >= 4
    assert [out for out in code[-1].outputs if "image/png" in out.get("data", {})]
