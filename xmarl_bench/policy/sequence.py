"""A sequence of linear maps, activation functions and graph layers as a `LayeredArchitecture`.

Linear maps that follow each other become one map, and a linear map before a graph layer becomes part of the
layer's own maps. The products are computed in float64.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from pydantic import ValidationError
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import DistributionKind, EdgeFeatures, LayeredArchitecture, raw_width
from xmarl_bench.records.strict_json import first_error, shown

AS_CODE = "bring this policy as code"


class Linear(NamedTuple):
    """x -> weight @ x + bias."""

    weight: Tensor  # (n_out, n_in)
    bias: Tensor  # (n_out,)


class Conv(NamedTuple):
    """A GATv2Conv or GATConv of one head, or with the mean of its heads, by its tensors."""

    tensors: Mapping[str, Tensor]
    edges: EdgeFeatures | None

    @property
    def n_in(self) -> int:
        return self.tensors["lin_l.weight" if self.is_v2 else "lin.weight"].shape[1]

    @property
    def is_v2(self) -> bool:
        return "att" in self.tensors

    @property
    def heads_and_width(self) -> tuple[int, int]:
        _, heads, width = self.tensors["att" if self.is_v2 else "att_src"].shape
        return heads, width


class Activated(NamedTuple):
    """An activation function; all of a sequence are the same."""


Step = Linear | Conv | Activated


def joined(steps: Sequence[Step]) -> list[Step]:
    """The same function as encoder, layers and decoder: (Linear Activated)* Conv+ (Linear Activated)* Linear.

    Raises InputError if that is impossible.
    """
    result: list[Step] = []
    for step in steps:
        before = result[-1] if result else None
        if isinstance(before, Linear) and isinstance(step, Linear):
            result[-1] = _after(before, step)
        elif isinstance(before, Linear) and isinstance(step, Conv):
            result[-1] = _conv_after(before, step)
        else:
            result.append(step)
    if isinstance(last := result[-1], Conv):
        width = last.heads_and_width[1]
        result.append(Linear(torch.eye(width), torch.zeros(width)))
    kinds = "".join({Linear: "L", Conv: "G", Activated: "a"}[type(step)] for step in result)
    if not re.fullmatch("(La)*G+(La)*L", kinds):
        what = "an MLP between two GNNs" if "G" in kinds else "no GNN"
        raise InputError(f"the actor has {what}, which a bundle cannot express: {AS_CODE}.")
    return result


def as_record(
    steps: Sequence[Step], activation: str, distribution: DistributionKind, **fields: Any
) -> tuple[LayeredArchitecture, dict[str, Tensor]]:
    """(architecture, weights with the names of `weight_shapes`) of steps in the form of `joined`.

    activation: an `Activation`. fields: further ones of the architecture. Raises InputError if a width is out
    of bounds.
    """
    layers = [step for step in steps if isinstance(step, Conv)]
    first = next(k for k, step in enumerate(steps) if isinstance(step, Conv))
    encoder, decoder = (
        [step for step in part if isinstance(step, Linear)] for part in (steps[:first], steps[first:])
    )
    weights: dict[str, Tensor] = {}
    for part, maps in (("encoder", encoder), ("decoder", decoder)):
        for k, each in enumerate(maps):
            weights |= {f"{part}.{2 * k}.weight": each.weight, f"{part}.{2 * k}.bias": each.bias}
    for k, layer in enumerate(layers):
        weights |= {f"layers.{k}.{name}": tensor for name, tensor in layer.tensors.items()}
    n_out = len(decoder[-1].bias)
    record = {
        "obs_dim": encoder[0].weight.shape[1] if encoder else layers[0].n_in,
        "action_dim": n_out // raw_width(distribution, 1),
        "encoder": tuple(len(each.bias) for each in encoder),
        "encoder_activation": activation,
        "layers": tuple(_layer(layer) for layer in layers),
        "decoder": tuple(len(each.bias) for each in decoder[:-1]),
        "decoder_activation": activation,
        "distribution": distribution,
        **fields,
    }
    try:
        return LayeredArchitecture.model_validate(record), weights
    except ValidationError as error:
        problem, where = first_error(error)
        raise InputError(
            f"the actor's {shown(where)} is out of bounds ({shown(problem)}): {AS_CODE}."
        ) from None


def _layer(layer: Conv) -> dict[str, Any]:
    heads, width = layer.heads_and_width
    return {
        "conv": "GATv2Conv" if layer.is_v2 else "GATConv",
        "width": width,
        "heads": heads,
        "concat": heads == 1,
        "residual": "res.weight" in layer.tensors,
        "edges": layer.edges,
        "activation": "identity",
    }


def _after(first: Linear, second: Linear) -> Linear:
    """second(first(x))"""
    if second.weight.shape[1] != first.weight.shape[0]:
        raise InputError("the widths of the actor's layers do not follow each other: save it again.")
    weight, bias = second.weight.double(), second.bias.double()
    return Linear((weight @ first.weight.double()).float(), (weight @ first.bias.double() + bias).float())


def _conv_after(first: Linear, layer: Conv) -> Conv:
    if not layer.is_v2:  # its map has no bias
        raise InputError(f"a GATConv after an MLP cannot be converted: {AS_CODE}.")
    tensors = dict(layer.tensors)
    for weight, bias in (
        ("lin_l.weight", "lin_l.bias"),
        ("lin_r.weight", "lin_r.bias"),
        ("res.weight", "bias"),
    ):
        if weight in tensors:
            tensors[weight], tensors[bias] = _after(first, Linear(tensors[weight], tensors[bias]))
    return Conv(tensors, layer.edges)
