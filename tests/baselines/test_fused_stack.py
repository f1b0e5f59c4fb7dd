"""A stack is the function of its linear layers and activations, with the same gradient."""

from __future__ import annotations

import copy
from itertools import pairwise

import pytest
import torch
from torch import Tensor, nn
from xmarl_baselines.fused_stack import ROWS, Layer, Stack, as_layers

ACTIVATIONS = {"tanh": nn.Tanh, "relu": nn.ReLU, "none": nn.Identity}


def network(widths: list[int], activation: str) -> nn.Sequential:
    torch.manual_seed(0)
    linear = [nn.Linear(n_in, n_out) for n_in, n_out in pairwise(widths)]
    return nn.Sequential(*(each for layer in linear for each in (layer, ACTIVATIONS[activation]())))


def layers_of(modules: nn.Sequential) -> list[Layer]:
    layers = as_layers(modules)
    assert layers is not None
    return layers


def there_and_back(stack: Stack, x: Tensor) -> tuple[Tensor, Tensor]:
    """The result, and the gradient of half the sum of its squares."""
    outs = stack.forward(x)
    return outs[-1], stack.backward(outs[-1].clone(), outs)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("widths", [[1, 1], [6, 9, 2], [32, 64, 64, 2]])
@pytest.mark.parametrize("rows", [1, 7, ROWS + 1])
def test_same_result_and_gradient_as_the_modules(activation: str, widths: list[int], rows: int) -> None:
    modules = network(widths, activation)
    x = torch.randn(rows, widths[0], requires_grad=True)
    expected = modules(x)
    (gradient,) = torch.autograd.grad(expected.square().sum() / 2, x)
    result = there_and_back(Stack(layers_of(modules)), x.detach())
    for mine, theirs in zip(result, (expected.detach(), gradient), strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-5, atol=1e-6)


def test_by_hand() -> None:
    stack = Stack([Layer(torch.tensor([[1.0, -1.0], [2.0, 0.5]]), torch.tensor([0.0, 1.0]), "relu")])
    x = torch.tensor([[1.0, 2.0]])  # 1 - 2 is cut off, 2 + 1 + 1 stays
    value, gradient = there_and_back(stack, x)
    assert value.tolist() == [[0.0, 4.0]]
    assert gradient.tolist() == [[8.0, 2.0]]  # 4 * [2, 0.5]


@pytest.mark.parametrize("n_out", [2, 3, 4])
def test_of_identities_only_square_ones_change_nothing(n_out: int) -> None:
    stack, x = Stack([Layer(torch.eye(n_out, 3), None, "none")]), torch.tensor([[1.0, 2.0, 3.0]])
    value, gradient = there_and_back(stack, x)
    assert value.tolist() == [[1.0, 2.0, 3.0, 0.0][:n_out]]
    assert gradient.tolist() == [[1.0, 2.0, 3.0 if n_out > 2 else 0.0]]


@pytest.mark.parametrize(
    "modules",
    [
        nn.Sequential(),
        nn.Sequential(nn.Tanh(), nn.Linear(2, 2)),
        nn.Sequential(nn.Linear(2, 2), nn.Tanh(), nn.ReLU()),
        nn.Sequential(nn.Linear(2, 2), nn.ELU()),
        nn.Sequential(nn.Linear(2, 2).double()),
        nn.Sequential(nn.Sequential(nn.Linear(2, 2))),
    ],
    ids=["nothing", "activation first", "two activations", "unknown", "double", "nested"],
)
def test_others_are_not_taken(modules: nn.Sequential) -> None:
    assert as_layers(modules) is None


def test_a_copy_is_the_same_function() -> None:
    stack, x = Stack(layers_of(network([3, 4, 2], "tanh"))), torch.randn(5, 3)
    for mine, theirs in zip(there_and_back(copy.deepcopy(stack), x), there_and_back(stack, x), strict=True):
        assert torch.equal(mine, theirs)
