"""Ranking quality, by hand and by the definitions of scikit-learn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xmarl_bench.planted.truth import auroc, average_precision

ONE = np.ones((1, 4), dtype=bool)
ONE[0, 1:] = False  # receiver 0 only


def row(*values: float) -> np.ndarray:
    """A mask of receiver 0: its own edge, then three messages."""
    mask = np.zeros((1, 4, 4))
    mask[0, 0] = (9.0, *values)
    return mask


def matters(*which: bool) -> np.ndarray:
    relevant = np.zeros((1, 4, 4), dtype=bool)
    relevant[0, 0, 1:] = which
    return relevant


def test_auroc_and_average_precision_by_hand() -> None:
    first, last = matters(True, False, False), matters(False, False, True)
    assert auroc(row(0.9, 0.5, 0.1), first, ONE) == average_precision(row(0.9, 0.5, 0.1), first, ONE) == 1.0
    assert auroc(row(0.9, 0.5, 0.1), last, ONE) == 0.0
    assert average_precision(row(0.9, 0.5, 0.1), last, ONE) == pytest.approx(1 / 3)
    two = matters(True, False, True)  # above and below the irrelevant one
    assert auroc(row(0.9, 0.5, 0.1), two, ONE) == 0.5
    assert average_precision(row(0.9, 0.5, 0.1), two, ONE) == pytest.approx((1 + 2 / 3) / 2)
    assert auroc(row(0.5, 0.5, 0.5), first, ONE) == 0.5
    assert average_precision(row(0.5, 0.5, 0.5), first, ONE) == pytest.approx(1 / 3)


@given(st.integers(0, 10**6))
def test_the_truth_scores_best_and_its_inverse_worst(seed: int) -> None:
    rng = np.random.default_rng(seed)
    relevant = np.zeros((5, 4, 4), dtype=bool)
    for s, i in np.ndindex(5, 4):
        relevant[
            s, i, rng.choice([j for j in range(4) if j != i], size=rng.integers(1, 3), replace=False)
        ] = True
    counted = np.ones((5, 4), dtype=bool)
    noisy = relevant + 0.9 * rng.random(relevant.shape)
    assert auroc(noisy, relevant, counted) == average_precision(noisy, relevant, counted) == 1.0
    assert auroc(-noisy, relevant, counted) == 0.0
