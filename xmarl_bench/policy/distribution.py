"""The distribution of each agent's next action."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from xmarl_bench.policy.architecture import DistributionKind, ScaleKind

SCALE_BIAS = math.log(math.e - 1.0)
MIN_SCALE = 1e-4
TORCHRL_FLOOR = 0.01
TORCHRL_BIAS = math.log(math.expm1(1.0 - TORCHRL_FLOOR))


class ActionDistribution(NamedTuple):
    """A distribution per agent: over A action entries, each for itself, or over A numbered actions.

    tanh_normal: tanh of a Normal(loc, scale). normal: a Normal(loc, scale), whose draws are clipped to
    [-1, 1], as in stable-baselines3. deterministic: tanh(loc); its scale is 0, and KL is undefined.
    categorical: one of A numbered actions, with probability exp(loc); its scale is 0.
    """

    loc: Tensor  # (..., N, A)
    scale: Tensor  # (..., N, A), positive for the two Normals
    kind: DistributionKind = "tanh_normal"

    @property
    def action(self) -> Tensor:
        """(..., N, A): F(m), which explainers explain and metrics compare.

        The deterministic action in [-1, 1]; for a categorical the probabilities of its actions.
        """
        if self.kind == "categorical":
            return self.loc.exp()
        return self.loc.clamp(-1.0, 1.0) if self.kind == "normal" else torch.tanh(self.loc)

    @property
    def choice(self) -> Tensor:
        """What a task takes: `action`, or (..., N) the number of the likeliest, the first of equal ones."""
        return self.loc.argmax(dim=-1) if self.kind == "categorical" else self.action

    @property
    def divisor(self) -> int:
        """The divisor of the sum over entries of |F_i(1) - F_i(m)| in d_i.

        A, so that d_i is a mean; 2 for a categorical, so that d_i is the total variation distance.
        """
        return 2 if self.kind == "categorical" else self.loc.shape[-1]


def action_distribution(
    raw: Tensor, kind: DistributionKind = "tanh_normal", scale: ScaleKind = "softplus"
) -> ActionDistribution:
    """(..., raw_width) output of a decoder -> the distribution.

    It holds locations, then scales before softplus; locations alone; or the logits of a categorical.
    """
    if kind == "categorical":
        return ActionDistribution(torch.log_softmax(raw, dim=-1), torch.zeros_like(raw), kind)
    if kind == "deterministic":
        return ActionDistribution(raw, torch.zeros_like(raw), kind)
    loc, raw_scale = raw.chunk(2, dim=-1)
    if scale == "torchrl":
        return ActionDistribution(loc, F.softplus(raw_scale + TORCHRL_BIAS) + TORCHRL_FLOOR, kind)
    return ActionDistribution(loc, F.softplus(raw_scale + SCALE_BIAS).clamp_min(MIN_SCALE), kind)
