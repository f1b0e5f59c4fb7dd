"""What a policy says about the next action of each agent."""

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
    """A distribution per agent and action entry.

    tanh_normal: tanh of a Normal(loc, scale). normal: a Normal(loc, scale), whose draws are clipped to
    [-1, 1], as stable-baselines3 has it. deterministic: tanh(loc) and nothing else; its scale is 0, and KL is
    undefined.
    """

    loc: Tensor  # (..., N, A)
    scale: Tensor  # (..., N, A), positive but for `deterministic`
    kind: DistributionKind = "tanh_normal"

    @property
    def action(self) -> Tensor:
        """(..., N, A) in [-1, 1]: the deterministic action, what the metrics compare."""
        return self.loc.clamp(-1.0, 1.0) if self.kind == "normal" else torch.tanh(self.loc)


def raw_width(kind: DistributionKind, action_dim: int) -> int:
    """How many numbers a decoder gives per agent."""
    return action_dim if kind == "deterministic" else 2 * action_dim


def action_distribution(
    raw: Tensor, kind: DistributionKind = "tanh_normal", scale: ScaleKind = "softplus"
) -> ActionDistribution:
    """(..., raw_width) output of a decoder -> the distribution: locations, then scales before softplus."""
    if kind == "deterministic":
        return ActionDistribution(raw, torch.zeros_like(raw), kind)
    loc, raw_scale = raw.chunk(2, dim=-1)
    if scale == "torchrl":
        return ActionDistribution(loc, F.softplus(raw_scale + TORCHRL_BIAS) + TORCHRL_FLOOR, kind)
    return ActionDistribution(loc, F.softplus(raw_scale + SCALE_BIAS).clamp_min(MIN_SCALE), kind)
