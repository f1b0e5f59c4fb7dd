"""A private copy of a policy whose weights are constants: the same function, differentiated by masks alone.

Explainers that optimise a mask spend their time in the decoder, which becomes a `Stack` where it can.
"""

from __future__ import annotations

import copy
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

from xmarl_baselines.fused_stack import Layer, Stack, as_layers
from xmarl_bench.policy import GraphPolicy, Policy

AnyPolicy = TypeVar("AnyPolicy", bound=Policy)
# float32 numbers: 28 MB, of the 32 MB up to which glibc learns from what is freed.
FREED_AT_LEAST = 7 * 2**20


def frozen(policy: AnyPolicy) -> AnyPolicy:
    """A copy in evaluation mode that needs no gradient of its weights; the policy given is not touched."""
    _keep_freed_memory()
    private = copy.deepcopy(policy).eval().requires_grad_(False)
    if isinstance(private, GraphPolicy):
        layers = as_layers(private.decoder)
        if layers is not None:
            private.decoder = nn.Sequential(Fused(layers))
    return private


def _keep_freed_memory() -> None:
    """Stop glibc from returning activations to the system after every step, to be fetched again page by page.

    It keeps twice the largest block ever freed. This one is never written to, so it takes no memory; a third
    of the time was spent on page faults without it.
    """
    torch.empty(FREED_AT_LEAST)


class Fused(nn.Module):
    """A decoder as a stack: one step of autograd."""

    def __init__(self, layers: list[Layer]) -> None:
        super().__init__()
        self.layers = layers
        self._stack = Stack(layers)

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = _Run.apply(x.reshape(-1, x.shape[-1]), self._stack)  # type: ignore[no-untyped-call]
        return out.reshape(*x.shape[:-1], -1)


class _Run(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, stack: Stack) -> Tensor:
        outs = stack.forward(x)
        ctx.stack = stack
        ctx.save_for_backward(*outs)
        return outs[-1]

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        return ctx.stack.backward(gradients[0].clone(), ctx.saved_tensors), None
