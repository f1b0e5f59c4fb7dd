"""Builds networks from architecture records."""

from __future__ import annotations

from torch import Tensor, nn

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import Architecture, LayeredArchitecture
from xmarl_bench.policy.bundle import PolicyCard, closed
from xmarl_bench.policy.layers import LayeredNetwork
from xmarl_bench.policy.module import ModulePolicy
from xmarl_bench.policy.network import GraphPolicy
from xmarl_bench.policy.shapes import weight_shapes
from xmarl_bench.policy.untrusted import misfit
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
            policy.load_state_dict({_as_gat(name): tensor for name, tensor in weights.items()})
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


def weights_of(policy: GraphPolicy | LayeredPolicy) -> dict[str, Tensor]:
    """The tensors of a policy that `build_policy` made, with the names of `weight_shapes`."""
    module: nn.Module = policy.network if isinstance(policy, LayeredPolicy) else policy
    return {name: tensor.detach() for name, tensor in module.state_dict().items()}


def _check_shapes(expected: dict[str, tuple[int, ...]], weights: dict[str, Tensor]) -> None:
    problem = misfit(expected, {name: tuple(tensor.shape) for name, tensor in weights.items()})
    if problem is not None:
        raise InputError(f"the weights do not fit the architecture: {problem}.")


def _as_gat(name: str) -> str:
    return f"gat.{name.removeprefix(LAYER)}" if name.startswith(LAYER) else name
