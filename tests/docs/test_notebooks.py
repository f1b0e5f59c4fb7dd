"""The notebooks run unchanged but for some numbers of steps and episodes, and end with a picture."""

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
SHORTER = {
    "own_explainer": {"episodes=5, timesteps=20": "episodes=2, timesteps=4, max_cycles=20"},
    "own_policy": {
        "step in range(301)": "step in range(2)",
        "timesteps=10, episodes=6": "timesteps=2, episodes=6",
        "episodes=3, timesteps=15, max_cycles=60": "episodes=2, timesteps=2, max_cycles=10",
        "max_cycles=120": "max_cycles=10",
    },
    "own_task": {
        "iteration in range(81)": "iteration in range(2)",
        "episodes=8, timesteps=10": "episodes=2, timesteps=4",
    },
}


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
    for longer, shorter in SHORTER[path.stem].items():
        (cell,) = [cell for cell in notebook.cells if longer in cell.source]
        cell.source = cell.source.replace(longer, shorter)
    notebook.cells.insert(0, nbformat.v4.new_code_cell("%reset -f"))  # names of the notebook before
    nbformat.write(notebook, tmp_path / path.name)
    notebook = runpy.run_path(str(DOCS / "run_notebooks.py"))["run"](tmp_path / path.name, kernel)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(code) >= 4
    assert [out for out in code[-1].outputs if "image/png" in out.get("data", {})]
