"""Makes a right ranking of messages worse in known steps, which a metric of rankings must follow.

The values of a row stay the same and go to other senders, so every step keeps as much as the right mask, and
only the ranking gets worse. In the second form, masks of worse rankings keep more, by a monotone change of
their values, which does not change a metric of the ranking.

As in the evaluation of F-Fidelity (Zheng et al., ICLR 2025), in which a metric must recover the order of an
explainer and degraded versions of it. Here the right ranking is known or assumed, not an explainer's.

S is the number of timesteps, N agents.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.metrics import other_senders, rank_correlation
from xmarl_bench.metrics.rank_correlation import DECIMALS

# Standard deviation of the noise, in units of the distance from the first to the last of a row. With two
# messages 0, 4, 12, 19, 26, 33, 39 and 45 % of the rows are exchanged.
NOISE: Final = (0.0, 0.4, 0.6, 0.8, 1.1, 1.6, 2.5, 6.0)
MOST_KEPT: Final = 0.9  # smallest value of the worst mask in the form KEEPS_MORE
Floats = NDArray[np.float64]


class Form(StrEnum):
    SAME_VALUES = "same values"
    KEEPS_MORE = "worse keeps more"


def degraded(mask: Tensor, noise: float, rng: np.random.Generator) -> Tensor:
    """(S, N, N) -> (S, N, N): every row's values in the order of value + noise; own edges are unchanged.

    mask: values in [0, 1] by which messages rank. Noise is normal and independent.
    """
    value = other_senders(mask.numpy().astype(np.float64))
    order = np.argsort(-(value + noise * rng.normal(size=value.shape)), axis=-1, kind="stable")
    dealt = np.empty_like(value)
    np.put_along_axis(dealt, order, -np.sort(-value, axis=-1), axis=-1)
    return with_messages(mask, dealt)


def in_form(mask: Tensor, form: Form, step: int) -> Tensor:
    """The mask of a step of NOISE in this form: the same ranking."""
    if form is Form.SAME_VALUES:
        return mask
    least = MOST_KEPT * step / (len(NOISE) - 1)
    return least + (1.0 - least) * mask


def with_messages(mask: Tensor, messages: Floats) -> Tensor:
    """(S, N, N) own edges, (S, N, N - 1) messages in ascending order of senders -> (S, N, N)."""
    n_agents = mask.shape[-1]
    whole = mask.clone()
    off_diagonal = ~torch.eye(n_agents, dtype=torch.bool)
    whole[:, off_diagonal] = torch.from_numpy(messages.reshape(len(mask), -1)).to(mask.dtype)
    return whole


def follows(values: Sequence[float], noise: Sequence[float], *, higher_is_better: bool) -> float:
    """Spearman's correlation of a metric with the quality of the ranking: 1 if it gets worse at every step.

    Values that are equal to DECIMALS decimals are ties. 0 if the metric is constant, NaN if a value is.
    `noise` may hold a value several times, as over policies.
    """
    better = np.round(values, DECIMALS) * (1.0 if higher_is_better else -1.0)
    if np.isnan(better).any():
        return math.nan
    found = rank_correlation(better, -np.asarray(noise))
    return 0.0 if np.isnan(found) else found
