"""Reads a network's attention from its layers.

A layer exposes its coefficients in one of torch_geometric's two ways:

- its `forward` takes `return_attention_weights` and then returns `(output, (edge_index, alpha))`, as GATConv,
  GATv2Conv and TransformerConv do; or
- its `message` has an argument `alpha`, passed to it by `propagate`.

alpha is (edges,) or (edges, heads).
"""

from __future__ import annotations

import inspect
from contextlib import ExitStack
from typing import Any

import torch
from torch import Tensor, nn
from torch_geometric.nn import MessagePassing

from xmarl_bench.policy.interface import NoAttentionError
from xmarl_bench.policy.messages import GivenEdges, followed, layers_of
from xmarl_bench.policy.recurrent import run


def attention_on(network: nn.Module, x: Tensor, edge_index: Tensor) -> Tensor:
    """(n, D), (2, edges) row-major -> (edges,): the mean of the coefficients over heads and layers.

    Raises NoAttentionError if no layer has attention.
    """
    given, found = GivenEdges(edge_index, len(x)), list[Tensor]()

    def keep(places: Tensor, alpha: Tensor) -> None:
        mean = alpha if alpha.dim() == 1 else alpha.flatten(1).mean(dim=1)
        found.append(torch.empty_like(mean).index_copy(0, places, mean))

    def ask(layer: MessagePassing, args: Any, kwargs: dict[str, Any], output: Any) -> None:
        """Call the layer once more, without this hook."""
        _, (received, alpha) = layer.forward(*args, **{**kwargs, "return_attention_weights": True})
        keep(given.places(layer, received), alpha)

    asked = [
        layer
        for layer in layers_of(network)
        if "return_attention_weights" in inspect.signature(layer.forward).parameters
    ]
    with ExitStack() as hooks:
        for layer in asked:
            hooks.callback(layer.register_forward_hook(ask, with_kwargs=True).remove)
        with followed(network, edge_index, len(x)) as calls:
            run(network, x, edge_index)
    for call in calls:
        for alpha in call.alphas:
            if call.layer not in asked and isinstance(alpha, Tensor):
                keep(call.places, alpha)
    if not found:
        raise NoAttentionError(f"{type(network).__name__} has no attention layer: choose another explainer.")
    return torch.stack(found).mean(dim=0)
