"""FidDelta against the budget k: the curves behind budgeted fidelity, over a cell's episodes."""

from __future__ import annotations

import numpy as np

from xmarl_bench.board.ranking import Floats
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
        points = [row_points for row in rows if (row_points := getattr(row, curve))]
        complete = [each for each in points if None not in each]
        if complete:
            episodes = np.array(complete, dtype=np.float64)
            curves[curve] = _with_band(episodes) if curve == "explained" else _rounded(episodes.mean(axis=0))
    return curves


def _with_band(episodes: Floats) -> list[list[float]]:
    """(E, K) -> K points with intervals."""
    if len(episodes) < 2:
        return _rounded(episodes.mean(axis=0))
    low, high = student_interval(episodes.T)
    return [
        [*mean, *least, *most]
        for mean, least, most in zip(*map(_rounded, (episodes.mean(axis=0), low, high)), strict=True)
    ]


def _rounded(values: Floats) -> list[list[float]]:
    return [[float(f"{value:.4g}")] for value in values]
