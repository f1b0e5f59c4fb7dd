"""FidDelta against the budget k: the curves behind budgeted fidelity, over a cell's episodes."""

from __future__ import annotations

import numpy as np

from xmarl_bench.entry.schema import CellResult
from xmarl_bench.metrics.student import student_interval

CURVES = ("explained", "random", "oracle")


def curves_of(cell: CellResult) -> dict[str, dict[str, list[list[float]]]]:
    """{"budget", "comm_budget"} -> {curve: points of k = 1 .. M - 1}.

    A point of `explained` is [mean, low, high] with the 95 % interval over episodes; a point of the others is
    [mean]. Omits episodes with missing numbers, and curves that no episode has.
    """
    return {name: _curves(cell, name) for name in ("budget", "comm_budget")}


def _curves(cell: CellResult, name: str) -> dict[str, list[list[float]]]:
    rows = [row for each in cell.episodes if (row := getattr(each, name)) is not None]
    curves = {}
    for curve in CURVES:
        complete = [points for row in rows if (points := getattr(row, curve)) and None not in points]
        if complete:
            episodes = np.array(complete, dtype=np.float64)  # (E, K)
            numbers = [episodes.mean(axis=0)]
            if curve == "explained" and len(episodes) > 1:
                numbers += student_interval(episodes.T)
            curves[curve] = [[float(f"{x:.4g}") for x in point] for point in zip(*numbers, strict=True)]
    return curves
