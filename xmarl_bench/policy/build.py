"""Builds networks from architecture records."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import Architecture, LayeredArchitecture
from xmarl_bench.policy.card import PolicyCard, closed
from xmarl_bench.policy.layers import LayeredNetwork
from xmarl_bench.policy.module import ModulePolicy
from xmarl_bench.policy.network import GraphPolicy
from xmarl_bench.policy.shapes import weight_shapes
from xmarl_bench.policy.untrusted import misfit
from xmarl_bench.policy.wrapped import plain_name, unwrapped
from xmarl_bench.reproducible import seeded

LAYER = "layers.0."  # prefix in LayeredNetwork of the layer that GraphPolicy calls `gat.`


class LayeredPolicy(ModulePolicy):
    """A `LayeredArchitecture` on the generic path."""

    def __init__(self, architecture: LayeredArchitecture, network: LayeredNetwork) -> None:
        super().__init__(
            network,
            architecture.obs_dim,
            architecture.action_dim,
            distribution=architecture.distribution,
            scale=architecture.scale,
            graph=architecture.graph,
        )
        self.architecture = architecture


def build_policy(
    architecture: Architecture | LayeredArchitecture, weights: dict[str, Tensor] | None = None
) -> GraphPolicy | LayeredPolicy:
    """A policy in evaluation mode, on the fast path if it supports the architecture.

    weights: tensors with the names and shapes of `weight_shapes`; without them, torch and torch_geometric
    draw initial weights from torch's global generator. Raises InputError if the architecture has too many
    parameters.
    """
    shapes = weight_shapes(architecture)
    if weights is not None:
        _check_shapes(shapes, weights)
    one_layer = architecture.as_one_layer() if isinstance(architecture, LayeredArchitecture) else architecture
    if one_layer is not None:
        policy = GraphPolicy(one_layer)
        if weights is not None:
            policy.load_state_dict({name.replace(LAYER, "gat."): each for name, each in weights.items()})
        return policy.eval()
    assert isinstance(architecture, LayeredArchitecture)
    network = LayeredNetwork(architecture)
    if weights is not None:
        network.load_state_dict(weights)
    return LayeredPolicy(architecture, network)


def initial_policy(card: PolicyCard) -> GraphPolicy | LayeredPolicy:
    """The network of a card as it was before training, bit for bit, in evaluation mode.

    Raises InputError if the card does not hold the seed of the initial weights.
    """
    if card.initial_seed is None:
        raise InputError(
            f"the card of {card.name!r} has no seed of its initial weights: set initial_seed, the number "
            f"given to torch.manual_seed before the network was built."
        )
    return untrained_policy(closed(card.architecture), card.initial_seed)


def untrained_policy(
    architecture: Architecture | LayeredArchitecture, seed: int
) -> GraphPolicy | LayeredPolicy:
    """The network with the weights that torch and torch_geometric draw after `torch.manual_seed(seed)`."""
    with seeded(seed):
        return build_policy(architecture)


def weights_of(policy: nn.Module) -> dict[str, Tensor]:
    """The tensors of a policy that `build_policy` made, in float32, with the names of `weight_shapes`.

    The policy may be wrapped (see xmarl_bench.policy.wrapped), on any device and in any precision. Raises
    InputError for another network, and if tensors were added or renamed, or are not finite.
    """
    network = closed_network(policy)
    module: nn.Module = network.network if isinstance(network, LayeredPolicy) else network
    state = {plain_name(name): tensor for name, tensor in module.state_dict().items()}
    _check_shapes(weight_shapes(network.architecture), state)
    for name, tensor in state.items():
        if tensor.is_meta or not tensor.is_floating_point() or not bool(torch.isfinite(tensor).all()):
            raise InputError(
                f"tensor {name!r} of the policy does not hold finite floating-point numbers: train it again."
            )
    return {name: tensor.detach().to("cpu", torch.float32).contiguous() for name, tensor in state.items()}


def closed_network(policy: nn.Module) -> GraphPolicy | LayeredPolicy:
    """The policy without its wrappers. Raises InputError if `build_policy` does not make such networks."""
    network = unwrapped(policy)
    if not isinstance(network, GraphPolicy | LayeredPolicy):
        raise InputError(
            f"a bundle holds networks of build_policy, got {type(network).__name__}: build one, or bring the "
            f"network as code, in a PolicyModule."
        )
    return network


def _check_shapes(expected: dict[str, tuple[int, ...]], weights: dict[str, Tensor]) -> None:
    problem = misfit(expected, {name: tuple(tensor.shape) for name, tensor in weights.items()})
    if problem is not None:
        raise InputError(f"the weights do not fit the architecture: {problem}.")
