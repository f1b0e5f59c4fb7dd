"""F(m) and its gradient with respect to the mask in closed form, in memory that every step uses again.

Autograd computes the same numbers, bit for bit, with more calls and new memory at each.

S is the number of timesteps, N agents, A action entries.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol

import torch
from torch import Tensor, nn

from xmarl_bench.policy import GraphPolicy, Policy
from xmarl_bench.policy.network import Prepared

Activation = Callable[[Tensor], Tensor]  # overwrites its input
Slope = Callable[[Tensor, Tensor], Tensor]  # g, y -> g times the derivative at output y; overwrites both
ACTIVATIONS: Final[dict[type[nn.Module], tuple[Activation, Slope]]] = {
    nn.ReLU: (torch.relu_, lambda g, y: g.mul_(y.sign_())),
    nn.Sigmoid: (torch.sigmoid_, lambda g, y: g.mul_(1 - y).mul_(y)),
    nn.Tanh: (torch.tanh_, lambda g, y: g.mul_(_one_minus_square(y))),
}


class Actions(Protocol):
    """F of prepared states. The policy's weights get no gradient."""

    def of(self, mask: Tensor) -> Tensor:
        """(S, N, N) -> (S, N, A): F(m)."""

    def gradient(self, slope: Tensor) -> Tensor:
        """(S, N, A) d loss / d F at the last mask -> (S, N, N) d loss / d mask. Once for each mask."""


def actions_of(policy: Policy, prepared: Any) -> Actions:
    """In closed form if each layer after the messages is known and none has a memory, else by autograd."""
    if isinstance(policy, GraphPolicy) and policy.architecture.distribution == "tanh_normal":
        layers = [policy.gat_activation, *policy.decoder]
        if policy.memory is None and all(type(each) in {nn.Linear, *ACTIVATIONS} for each in layers):
            return _ClosedForm(layers, prepared)
    return _Autograd(policy, prepared)


class _Autograd:
    def __init__(self, policy: Policy, prepared: Any) -> None:
        self.policy, self.prepared = policy, prepared

    def of(self, mask: Tensor) -> Tensor:
        with torch.enable_grad():
            self.mask = mask.detach().requires_grad_()
            self.action = self.policy.decode(self.prepared, self.mask).action
        return self.action.detach()

    def gradient(self, slope: Tensor) -> Tensor:
        return torch.autograd.grad(self.action, [self.mask], slope)[0]


class _ClosedForm:
    def __init__(self, layers: list[nn.Module], prepared: Prepared) -> None:
        self.layers, self.prepared = layers, prepared
        self.hidden = torch.empty_like(prepared.message)
        n_rows = self.hidden[..., 0].numel()
        linear = [each for each in layers if isinstance(each, nn.Linear)]
        self.outputs = [self.hidden.new_empty(n_rows, each.out_features) for each in linear]
        self.slopes = [self.hidden.new_empty(n_rows, each.in_features) for each in linear]
        self.raw_slope = torch.zeros_like(self.outputs[-1])  # stays 0 for scales: F is made of locations

    @torch.no_grad()
    def of(self, mask: Tensor) -> Tensor:
        weight = self.prepared.attention * mask
        torch.bmm(weight, self.prepared.message, out=self.hidden).add_(self.prepared.own)
        x, outputs = self.hidden.flatten(0, 1), iter(self.outputs)
        self.active = list[Tensor]()
        for layer in self.layers:
            if isinstance(layer, nn.Linear):
                x = torch.addmm(layer.bias, x, layer.weight.t(), out=next(outputs))
            else:
                self.active.append(ACTIVATIONS[type(layer)][0](x))
        self.action = x.chunk(2, dim=-1)[0].contiguous().tanh_().view(*mask.shape[:2], -1)
        return self.action

    @torch.no_grad()
    def gradient(self, slope: Tensor) -> Tensor:
        g, slopes = self.raw_slope, reversed(self.slopes)
        g.chunk(2, dim=-1)[0].copy_((slope * _one_minus_square(self.action)).flatten(0, 1))
        for layer in reversed(self.layers):
            if isinstance(layer, nn.Linear):
                g = torch.mm(g, layer.weight, out=next(slopes))
            else:
                ACTIVATIONS[type(layer)][1](g, self.active.pop())
        by_weight = torch.bmm(g.view_as(self.hidden), self.prepared.message.transpose(1, 2))
        return by_weight.mul_(self.prepared.attention)


def _one_minus_square(y: Tensor) -> Tensor:
    return torch.addcmul(y.new_ones(()), y, y, value=-1)  # rounded once, as in autograd's gradient of tanh
