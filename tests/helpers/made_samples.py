"""Samples with random numbers, as of a study of three training runs per cell."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from xmarl_bench.papers.kailas2025.claims import Cell, Term
from xmarl_bench.papers.kailas2025.samples import KEPT, Floats, Place, Run, Samples

SEEDS = (0, 1, 2)
Level = Callable[[Cell, str, bool, str], float]  # cell, explainer, regularised, metric -> mean


def made_samples(
    cells: Iterable[Cell], explainers: Iterable[str], level: Level, *, episodes: int = 50, noise: float = 0.1
) -> Samples:
    """Every explainer on every run; the values of an episode are `level` and noise that runs share."""
    samples, names = Samples(), list(explainers)
    for cell in cells:
        for seed in SEEDS:
            rng = np.random.default_rng([seed, cell.n_trained, cell.percent or 0, cell.more or 0])
            shared = noise * rng.standard_normal(episodes)
            for regularised in (False, True):
                for name in names:
                    own = 0.1 * noise * rng.standard_normal(episodes)
                    values: dict[str, Floats] = {
                        metric: level(cell, name, regularised, metric) + shared + own for metric in KEPT
                    }
                    known = samples.scored.setdefault((Place.of(cell, Term(name)), name), {})
                    known[Run("a", 0.1 * regularised, seed)] = values
    return samples
