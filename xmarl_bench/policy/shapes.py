"""Names and shapes of an architecture's tensors, by arithmetic, to check untrusted weights against.

Builds no network and does not import torch. Names are those of `GraphPolicy` and `LayeredNetwork`, with
torch_geometric's names within a layer; tests compare them with the networks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import Architecture, GraphLayer, LayeredArchitecture, Memory, raw_width

MAX_PARAMETERS = 16 * 1024 * 1024  # 64 MB of float32
Shapes = dict[str, tuple[int, ...]]


def weight_shapes(architecture: Architecture | LayeredArchitecture) -> Shapes:
    """The shape of every tensor by its name. Raises InputError for more than MAX_PARAMETERS parameters."""
    a = architecture
    encoder = (a.obs_dim, *a.encoder)
    shapes = _mlp("encoder", encoder)
    if isinstance(a, Architecture):
        layer = GraphLayer(
            conv="GATv2Conv", width=a.gat_width, activation=a.gat_activation, residual=a.residual
        )
        layers = {"gat": layer}
    else:
        layers = {f"layers.{k}": layer for k, layer in enumerate(a.layers)}
    widths = [encoder[-1], *(layer.out_width for layer in layers.values())]
    if a.memory is not None:
        shapes |= _memory(widths[a.memory.after], a.memory)
        widths[a.memory.after] = a.memory.width
    for n_in, (name, layer) in zip(widths, layers.items(), strict=False):
        shapes |= _layer(name, n_in, layer)
    shapes |= _mlp("decoder", (widths[-1], *a.decoder, raw_width(a.distribution, a.action_dim)))
    total = sum(math.prod(shape) for shape in shapes.values())
    if total > MAX_PARAMETERS:
        raise InputError(
            f"the architecture has {total} parameters, more than the limit of {MAX_PARAMETERS}: "
            f"make it narrower."
        )
    return shapes


def _mlp(name: str, widths: Sequence[int]) -> Shapes:
    """Indices count the activations too, so linear layers are 0, 2, 4."""
    shapes: Shapes = {}
    for k, (n_in, n_out) in enumerate(pairwise(widths)):
        shapes |= _linear(f"{name}.{2 * k}", n_in, n_out)
    return shapes


def _linear(name: str, n_in: int, n_out: int, *, bias: bool = True) -> Shapes:
    return {f"{name}.weight": (n_out, n_in), **({f"{name}.bias": (n_out,)} if bias else {})}


def _memory(n_in: int, memory: Memory) -> Shapes:
    gates = (3 if memory.cell == "gru" else 4) * memory.width
    weights = {"memory.weight_ih": (gates, n_in), "memory.weight_hh": (gates, memory.width)}
    return {**weights, "memory.bias_ih": (gates,), "memory.bias_hh": (gates,)}


def _layer(name: str, n_in: int, layer: GraphLayer) -> Shapes:
    every_head = layer.width * layer.heads
    coefficients = (1, layer.heads, layer.width)
    if layer.conv == "TransformerConv":  # it has lin_skip whether it uses it or not
        shapes = _linear(f"{name}.lin_skip", n_in, layer.out_width)
        for part in ("lin_key", "lin_query", "lin_value"):
            shapes |= _linear(f"{name}.{part}", n_in, every_head)
        return shapes | _edges(name, layer)
    shapes = {f"{name}.bias": (layer.out_width,), **_edges(name, layer)}
    if layer.residual:
        shapes |= _linear(f"{name}.res", n_in, layer.out_width, bias=False)
    if layer.conv == "GATConv":
        parts = ("src", "dst") if layer.edges is None else ("src", "dst", "edge")
        shapes |= {f"{name}.att_{part}": coefficients for part in parts}
        return shapes | _linear(f"{name}.lin", n_in, every_head, bias=False)
    shapes[f"{name}.att"] = coefficients
    return shapes | _linear(f"{name}.lin_l", n_in, every_head) | _linear(f"{name}.lin_r", n_in, every_head)


def _edges(name: str, layer: GraphLayer) -> Shapes:
    if layer.edges is None:
        return {}
    return _linear(f"{name}.lin_edge", layer.edges.width, layer.width * layer.heads, bias=False)
