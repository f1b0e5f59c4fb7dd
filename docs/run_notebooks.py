"""Runs the notebooks of docs/notebooks and saves their outputs: `python docs/run_notebooks.py`."""

from __future__ import annotations

import os
from pathlib import Path

import nbformat
from jupyter_client.manager import KernelManager
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parent / "notebooks"


def run(path: Path, kernel: KernelManager | None = None) -> nbformat.NotebookNode:
    """Run a notebook in that running kernel, or a new one; returns it with outputs.

    Without a kernel it runs in its folder. Raises CellExecutionError if a cell fails.
    """
    notebook: nbformat.NotebookNode = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook, km=kernel, timeout=600, kernel_name="python3", record_timing=False,
        resources={"metadata": {"path": str(path.parent)}},
    )  # fmt: skip
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    client.execute()
    for cell in (cell for cell in notebook.cells if cell.cell_type == "code"):
        # Libraries' warnings differ between machines.
        cell.outputs = [out for out in cell.outputs if out.get("name") != "stderr"]
    return notebook


if __name__ == "__main__":
    for each in sorted(NOTEBOOKS.glob("*.ipynb")):
        nbformat.write(run(each), each)
