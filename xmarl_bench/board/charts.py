"""Geometry of the page's charts: everything is in percent of the plot, so that charts fit every screen."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

LEAST = -1.0  # where axes of unbounded metrics end: values below are drawn at the end
GRID = 24  # points of a density


@dataclass(frozen=True)
class Axis:
    low: float
    high: float
    least_step: float = 0.0  # of ticks

    def at(self, value: float) -> float:
        """Percent of the way from low to high, within 0 and 100."""
        share = (value - self.low) / (self.high - self.low)
        return round(100.0 * min(1.0, max(0.0, share)), 2)

    @property
    def ticks(self) -> list[float]:
        """Between three and seven round values."""
        raw = max(self.least_step, (self.high - self.low) / 4)
        scale = 10.0 ** math.floor(math.log10(raw))
        step = next(scale * k for k in (1, 2, 2.5, 5, 10) if scale * k >= raw * 0.99)
        first = math.ceil(self.low / step - 1e-9)
        return [round(step * k, 9) for k in range(first, math.floor(self.high / step + 1e-9) + 1)]


def axis_of(values: Iterable[float | None], *, around: Sequence[float] = ()) -> Axis:
    """The axis of all values, with those of `around` inside of it and a little room at both ends."""
    numbers = [max(LEAST, value) for value in values if value is not None] + list(around)
    low, high = (min(numbers), max(numbers)) if numbers else (0.0, 1.0)
    room = 0.03 * (high - low) or 0.5
    return Axis(low - room, high + room)


def line(points: Iterable[tuple[float, float]], x: Axis, y: Axis) -> str:
    """`points` of an SVG polyline in a square of 100 x 100, y upwards."""
    return " ".join(f"{x.at(a):g},{100.0 - y.at(b):g}" for a, b in points)


def steps(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Corners of a step function that jumps at each point to its value."""
    corners = list(points[:1])
    for (_, before), (x, y) in pairwise(points):
        corners += [(x, before), (x, y)]
    return corners


def half_density(values: ArrayLike, axis: Axis, side: int) -> str:
    """Points of a polygon: the density of the values above (side 1) or below (-1) the line y = 50.

    A Gaussian kernel with Silverman's width, from the least value to the largest: it shows nothing where no
    value is. Values that are all equal give a bar.
    """
    x = np.asarray(values, dtype=np.float64)
    low, high = float(x.min()), float(x.max())
    quarter, three = np.quantile(x, [0.25, 0.75])
    spread = min(float(x.std(ddof=1)) if x.size > 1 else 0.0, (three - quarter) / 1.34 or math.inf)
    if not 0.0 < spread < math.inf:
        grid, heights = np.array([low - 0.002, high + 0.002]), np.ones(2)
    else:
        width = 0.9 * spread * x.size**-0.2
        grid = np.linspace(low, high, GRID)
        heights = np.exp(-0.5 * ((grid[:, None] - x) / width) ** 2).sum(axis=1)
        heights /= heights.max()
    edge = [(axis.at(float(a)), 50.0 - side * 46.0 * float(b)) for a, b in zip(grid, heights, strict=True)]
    ends = [(edge[0][0], 50.0), *edge, (edge[-1][0], 50.0)]
    return " ".join(f"{a:g},{b:.3g}" for a, b in ends)
