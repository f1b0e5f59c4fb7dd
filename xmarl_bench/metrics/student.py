"""Student's intervals and tests of means whose units may belong together.

Runs that share the start of their training, as with and without a regulariser, are not independent: they form
a cluster, which counts as one training. A mean over several cells is the mean of their means: further
trainings in a cell narrow its interval and do not change the cell's weight. Deviations are from the mean over
all cells, so the interval of such a mean is wide for these cells, and says nothing of other tasks.

Units that are all equal up to rounding, and not 0, do not show how units spread: rates of few episodes are
often equal by chance. Then p is of the sign test, and there is an interval only if that test decides, from
six units on. Clusters count as equal if their means are.

Sources: Student (1908); Liang and Zeger (1986), clusters; Kish (1965), effective number; Arbuthnot (1710),
sign test.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.errors import InputError

Floats = NDArray[np.float64]
CONFIDENCE = 0.95
ROUNDING = 1e-9  # of sums in another order, and of entries; relative to values above 1


@dataclass(frozen=True)
class Design:
    """Which units belong together: U labels each.

    clusters: units of one cluster are not independent, and weigh together as much as another cluster. cells:
    the mean is over cells of the mean over a cell's clusters; without them, over all clusters.
    """

    clusters: tuple[Hashable, ...]
    cells: tuple[Hashable, ...] = ()

    def __post_init__(self) -> None:
        if self.cells and len(self.cells) != len(self.clusters):
            raise InputError(
                f"got {len(self.cells)} cells for {len(self.clusters)} units: give a label for each."
            )

    def of(self, kept: Sequence[int]) -> Design:
        """The design of some of the units."""
        return Design(tuple(self.clusters[k] for k in kept), tuple(self.cells[k] for k in kept if self.cells))

    @cached_property
    def weights(self) -> Floats:
        """(U,): of each unit in the mean; their sum is 1."""
        cells = self.cells or (None,) * len(self.clusters)
        units = Counter(zip(cells, self.clusters, strict=True))
        clusters = Counter(cell for cell, _ in units)
        return np.array(
            [
                1.0 / (len(clusters) * clusters[cell] * units[cell, cluster])
                for cell, cluster in zip(cells, self.clusters, strict=True)
            ]
        )

    @cached_property
    def members(self) -> Floats:
        """(U, G): 1 where a unit is of a cluster."""
        labels = dict.fromkeys(self.clusters)
        return np.array([[float(each == label) for label in labels] for each in self.clusters])


def student_interval(
    units: Floats, confidence: float = CONFIDENCE, *, design: Design | None = None
) -> tuple[Floats, Floats]:
    """(..., U) -> low and high (...) of the mean over the last axis, for two independent units or more.

    Of width 0 if all units are equal, see `interval_of`.
    """
    from scipy.special import stdtrit  # imported lazily: reading entries does not need scipy

    mean, error, freedom = _student(units, design)
    half = stdtrit(freedom, 0.5 + confidence / 2) * error
    return mean - half, mean + half


def interval_of(
    units: Floats, confidence: float = CONFIDENCE, *, design: Design | None = None
) -> tuple[float, float] | None:
    """(U,) -> `student_interval`; None for fewer than two independent units, or few that are all equal."""
    n = n_independent(units, design)
    decided = is_zero(units) or _sign_test(n) < 1.0 - confidence
    if n < 2 or (_equal(units, design) and not decided):
        return None
    low, high = student_interval(units, confidence, design=design)
    return float(low), float(high)


def student_p(units: Floats, *, design: Design | None = None) -> Floats:
    """(..., U) -> (...): two-sided p of a mean of 0 over the last axis, for two independent units or more.

    If all units are equal, p is 1 if they are 0, and otherwise that of the sign test.
    """
    from scipy.special import stdtr

    mean, error, freedom = _student(units, design)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = 2.0 * stdtr(freedom, -np.abs(mean) / error)
    alike = np.where(is_zero(units), 1.0, _sign_test(n_independent(units, design)))
    return np.asarray(np.where(_equal(units, design), alike, p))


def mean_of(units: Floats, design: Design | None) -> Floats:
    """(..., U) -> (...): the mean over the last axis."""
    n = units.shape[-1]
    return np.asarray(units.sum(axis=-1) / n if design is None else (units * design.weights).sum(axis=-1))


def n_independent(units: Floats, design: Design | None) -> int:
    """The number of units (..., U) that are independent."""
    return units.shape[-1] if design is None else len(set(design.clusters))


def standard_error(units: Floats) -> Floats:
    """(..., U) -> (...): of the mean over the last axis, of independent units."""
    return np.asarray(units.std(axis=-1, ddof=1) / math.sqrt(units.shape[-1]))


def _student(units: Floats, design: Design | None) -> tuple[Floats, Floats, float]:
    """(..., U) -> mean and its standard error (...), and the degrees of freedom.

    With a design the error is that of the sums of clusters, whatever their units have in common, unbiased if
    clusters are independent and vary alike. The degrees of freedom are one less than Kish's effective number
    of clusters, which is smaller if some weigh more. Without weights and clusters both are Student's.
    """
    mean = mean_of(units, design)
    if design is None:
        return mean, np.where(_equal(units, None), 0.0, standard_error(units)), units.shape[-1] - 1.0
    weights, members = design.weights, design.members
    sums = ((units - mean[..., None]) * weights) @ members
    shares = weights @ members
    square, cube = float(np.square(shares).sum()), float((shares**3).sum())
    error = np.sqrt(np.square(sums).sum(axis=-1) * square / (square - 2.0 * cube + square**2))
    return mean, np.where(_equal(units, design), 0.0, error), 1.0 / square - 1.0


def _equal(units: Floats, design: Design | None) -> NDArray[np.bool_]:
    """(..., U) -> (...): whether all units, or the means of clusters, are equal up to rounding."""
    means = units
    if design is not None:
        weights, members = design.weights, design.members
        means = (units * weights) @ members / (weights @ members)
    return is_zero(means - means[..., :1], np.abs(units).max(axis=-1))


def is_zero(values: Floats, scale: Floats | float = 0.0) -> NDArray[np.bool_]:
    """(..., U) -> (...): whether all values are 0 up to the rounding of numbers of that scale."""
    return np.asarray(np.abs(values).max(axis=-1) <= ROUNDING * np.maximum(1.0, scale))


def _sign_test(n: int) -> float:
    """Two-sided p of n independent units that are all on one side of 0."""
    return float(2.0 ** (1 - n))
