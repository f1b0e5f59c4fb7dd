"""The messages that a network's layers pass: assigns each to its edge, and scales it by a mask.

A layer may receive edges in another order than the network: sorted, or with loops at the end. So messages are
matched to a mask by sender and receiver, never by position.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch_geometric.nn import MessagePassing

from xmarl_bench.errors import InputError

Inputs = tuple[Any, ...]


class GivenEdges:
    """The edges given to a network, (2, edges), each once and row-major by receiver: see `row_major`."""

    def __init__(self, edge_index: Tensor, n_nodes: int) -> None:
        self.edge_index, self.n_nodes = edge_index, n_nodes
        self.keys = self._keys(*edge_index)
        self.in_order = torch.arange(len(self.keys))

    def places(self, layer: MessagePassing, received: Tensor) -> Tensor:
        """(2, edges) that a layer receives -> for each of its messages, the index of its edge in ours.

        Raises InputError if the messages are not one for each edge.
        """
        sender, receiver = ends_of(layer, received)
        keys = self._keys(sender, receiver)
        if torch.equal(keys, self.keys):
            return self.in_order
        if not torch.equal(keys.sort().values, self.keys):
            raise InputError(self._difference(layer, sender, receiver))
        return torch.searchsorted(self.keys, keys)

    def _keys(self, sender: Tensor, receiver: Tensor) -> Tensor:
        return receiver * self.n_nodes + sender

    def _difference(self, layer: MessagePassing, sender: Tensor, receiver: Tensor) -> str:
        """The error message: what was received, and the first edge that is unknown, missing or repeated."""
        given = list(zip(*self.edge_index.tolist(), strict=True))
        passed = Counter(zip(sender.tolist(), receiver.tolist(), strict=True))
        received = f"{type(layer).__name__} passes {passed.total()} messages on {len(given)} edges"
        graph = set(given)
        unknown = next((edge for edge in passed if edge not in graph), None)
        if unknown is not None and unknown[0] == unknown[1]:
            return (
                f"{received}: it adds the loop {_shown(unknown)}, which the policy's graph does not have; "
                f"build it with add_self_loops=False, or give the policy a graph with loops."
            )
        if unknown is not None:
            return (
                f"{received}: {_shown(unknown)} is not an edge of the policy's graph; pass messages from "
                f"sender to receiver, on the edges given to forward."
            )
        missing = next((edge for edge in given if edge not in passed), None)
        if missing is not None:
            return f"{received}: it drops {_shown(missing)}; keep every edge and scale messages."
        twice = next(edge for edge, count in passed.items() if count > 1)
        return f"{received}: {_shown(twice)} has more than one; pass one message for each edge."


class Call(NamedTuple):
    """One call of a layer's message passing."""

    layer: MessagePassing
    places: Tensor  # for each message, the index of its edge among those given
    alphas: list[Any]  # for each call of `message`, its argument `alpha` or None


@contextmanager
def followed(
    network: nn.Module, edge_index: Tensor, n_nodes: int, mask: Tensor | None = None
) -> Iterator[list[Call]]:
    """Record the calls of message passing while the network runs on these edges inside the block.

    mask: (edges,), scales every message on its edge, in every layer. Raises InputError, from within the
    network, if a layer's messages are not one for each edge.
    """
    given, calls = GivenEdges(edge_index, n_nodes), list[Call]()

    def begin(layer: MessagePassing, inputs: Inputs) -> None:
        calls.append(Call(layer, given.places(layer, inputs[0]), []))

    def scale(layer: MessagePassing, inputs: Inputs, message: Tensor) -> Tensor:
        call = next(each for each in reversed(calls) if each.layer is layer)
        call.alphas.append(inputs[0].get("alpha"))
        if message.shape[layer.node_dim] != len(call.places):
            raise InputError(
                f"{type(layer).__name__} makes {message.shape[layer.node_dim]} messages on "
                f"{len(call.places)} edges: let `message` return one for each edge."
            )
        if mask is None:
            return message
        scales = mask if call.places is given.in_order else mask.index_select(0, call.places)
        shape = [1] * message.dim()
        shape[layer.node_dim] = -1
        return message * scales.view(shape)

    def end(layer: MessagePassing, inputs: Inputs, output: Any) -> None:
        if not next(each for each in reversed(calls) if each.layer is layer).alphas:
            raise InputError(
                f"{type(layer).__name__} sums its messages without computing each one, so masks cannot scale "
                f"them: pass edge_index as a plain tensor."
            )

    with ExitStack() as hooks:
        for layer in layers_of(network):
            for handle in (
                layer.register_propagate_forward_pre_hook(begin),
                layer.register_message_forward_hook(scale),
                layer.register_propagate_forward_hook(end),
            ):
                hooks.callback(handle.remove)
        yield calls


def layers_of(network: nn.Module) -> Iterator[MessagePassing]:
    return (module for module in network.modules() if isinstance(module, MessagePassing))


def ends_of(layer: MessagePassing, edge_index: Tensor) -> tuple[Tensor, Tensor]:
    """(2, edges) that a layer receives -> sender and receiver of each of its messages."""
    if not isinstance(edge_index, Tensor) or edge_index.layout != torch.strided:
        raise InputError(
            f"{type(layer).__name__} receives its edges as a sparse matrix, whose messages masks cannot "
            "scale: pass edge_index as a plain tensor."
        )
    if layer.flow != "source_to_target":  # torch_geometric's masks would compute another function
        raise InputError(
            f"{type(layer).__name__} passes messages from target to source: build it with "
            f"flow='source_to_target'."
        )
    sender, receiver = edge_index
    return sender, receiver


def row_major(edge_index: Tensor, n_nodes: int, weight: Tensor | None = None) -> tuple[Tensor, Tensor | None]:
    """(2, edges) and weights (edges,), both sorted by receiver, then sender: the order of our mask."""
    sender, receiver = edge_index
    order = (receiver * n_nodes + sender).argsort()
    return edge_index[:, order], None if weight is None else weight[order]


def _shown(edge: tuple[int, int]) -> str:
    return f"{edge[0]} -> {edge[1]}"
