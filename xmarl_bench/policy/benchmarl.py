"""Reads the actor of a BenchMARL checkpoint: its architecture from names and shapes, and its weights.

BenchMARL (Bettini et al., JMLR 2024) writes `checkpoints/checkpoint_<frames>.pt`, which holds actor, critic
and buffer of each group of agents. An actor is a GNN, or a `SequenceModel` of GNNs and MLPs. `Settings` holds
what a checkpoint does not tell. torch_geometric's defaults are assumed for arguments of layers that leave no
trace in names and shapes, such as `negative_slope`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, get_args

import torch
from pydantic import ValidationError
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import (
    Activation,
    DistributionKind,
    EdgeFeatures,
    LayeredArchitecture,
    ScaleKind,
)
from xmarl_bench.policy.convert import dense, rename
from xmarl_bench.policy.distribution import SCALE_BIAS, TORCHRL_BIAS, TORCHRL_FLOOR
from xmarl_bench.policy.sequence import AS_CODE, Activated, Conv, Linear, Step, as_record, joined
from xmarl_bench.records.strict_json import shown

MAX_SIDE = 4096  # of a tensor, so that products of two matrices stay small
SCALE_MAPPING = "biased_softplus_1.0"
# models.module.<k>. is in a `SequenceModel`; a second module.0. if the output becomes (loc, scale).
_NAME = re.compile(
    r"module\.0\.(?P<scaled>module\.0\.)?(?:models\.module\.(?P<model>\d{1,3})\.)?"
    r"(?:gnns\.(?P<agent>\d+)|mlp\.params)\.(?P<tensor>.+)"
)


class Settings(NamedTuple):
    """What names and shapes of tensors do not tell."""

    activation: str | None = None  # an `Activation`: `activation_class` of every MLP
    # What lets agents hear themselves. layer: its `add_self_loops`, True by default. graph: `self_loops`.
    loops: Literal["layer", "graph", "none"] | None = None
    scale_mapping: str | None = None  # None: BenchMARL's default
    use_tanh_normal: bool | None = None  # None: True, BenchMARL's default
    group: str | None = None  # of agents; needed if the checkpoint has several
    inputs: Sequence[int] | None = None  # entry of an observation that each input of the actor is
    position: Sequence[int] = ()  # entries that `position_key` held
    velocity: Sequence[int] = ()  # entries that `velocity_key` held
    radius: float | None = None  # metres, `edge_radius` of the topology from_pos; inf: the topology full


def read_actor(
    tensors: Mapping[str, Tensor], settings: Settings, obs_dim: int
) -> tuple[LayeredArchitecture, dict[str, Tensor]]:
    """(architecture, weights with the names of `weight_shapes`) of the actor among a checkpoint's tensors.

    obs_dim: entries of an observation in the task. Raises InputError if there is no actor, if a bundle cannot
    express it, or if a setting is missing.
    """
    group = _group(tensors, settings.group)
    actor = rename(tensors, {"": None, f"loss_{group}.actor_network_params.": ""})
    for name, tensor in actor.items():
        if max(tensor.shape, default=0) > MAX_SIDE:
            raise InputError(f"tensor {shown(name)} has more than {MAX_SIDE} rows or columns: {AS_CODE}.")
    actor = dense(actor, {name: tuple(tensor.shape) for name, tensor in actor.items()})
    scaled, models = _models(actor)
    if settings.loops is None:
        raise InputError(
            "the checkpoint does not tell whether agents hear themselves: give --loops layer, the default of "
            "GATv2Conv and GATConv, or, if gnn_kwargs had add_self_loops=False, --loops graph for "
            "self_loops=True and --loops none for self_loops=False."
        )
    steps = joined(
        [*_selection(settings, obs_dim), *(s for model in models for s in _steps(model, settings))]
    )
    if settings.activation is None and any(isinstance(step, Activated) for step in steps):
        raise InputError(
            "the checkpoint does not tell the activation function of its MLPs: give --activation, e.g. tanh."
        )
    activation = settings.activation or "identity"
    if activation not in get_args(Activation):
        raise InputError(
            f"no activation function {shown(activation)}: choose from {', '.join(get_args(Activation))}."
        )
    scale: ScaleKind = "softplus"
    distribution: DistributionKind = "categorical"
    if scaled:
        scale, steps[-1] = _mapped(steps[-1], settings.scale_mapping or SCALE_MAPPING)
        distribution = "normal" if settings.use_tanh_normal is False else "tanh_normal"
    elif any(name.startswith(f"loss_{group}.value_network_params.") for name in tensors):
        distribution = "deterministic"  # MADDPG, IDDPG
    return as_record(
        steps,
        activation,
        distribution,
        scale=scale,
        graph=_graph(steps, settings),
    )


def _graph(steps: Sequence[Step], settings: Settings) -> dict[str, object]:
    loops = settings.loops != "none"
    radius = math.inf if settings.radius is None else settings.radius
    placed = any(isinstance(s, Conv) and s.edges is not None and s.edges.position for s in steps)
    if placed and settings.radius is None:
        raise InputError(
            "the checkpoint does not tell the topology of a GNN that gets positions: give --radius, the "
            "edge_radius of from_pos, or --radius inf for full."
        )
    if radius == math.inf:
        return {"kind": "complete", "loops": loops}
    if not placed or not radius > 0:
        raise InputError(
            f"--radius is {radius:g}: give a distance above 0, and only for a GNN that gets positions."
        )
    return {"kind": "radius", "radius": radius, "position": tuple(settings.position), "loops": loops}


def _group(tensors: Mapping[str, Tensor], given: str | None) -> str:
    found = {match[1] for name in tensors if (match := re.match(r"loss_(.+?)\.actor_network_params\.", name))}
    if not found:
        raise InputError(
            "the file has no actor of BenchMARL: give checkpoints/checkpoint_<frames>.pt of MAPPO, IPPO, "
            "MASAC, ISAC, MADDPG or IDDPG."
        )
    if given is None and len(found) == 1:
        return found.pop()
    if given is None or given not in found:
        was = "several groups of agents" if given is None else f"no group {shown(given)}"
        raise InputError(f"the checkpoint has {was}: give --group, one of {shown(', '.join(sorted(found)))}.")
    return given


def _models(actor: Mapping[str, Tensor]) -> tuple[bool, list[dict[str, Tensor]]]:
    """Whether the output is (loc, scale); the tensors of each GNN and MLP, in sequence."""
    scaled, models = False, dict[int, dict[str, Tensor]]()
    for name, tensor in actor.items():
        match = _NAME.fullmatch(name)
        if match is None:
            raise InputError(f"tensor {shown(name)} of the actor belongs to no GNN or MLP: {AS_CODE}.")
        stacked = match["agent"] is None and tensor.dim() == (3 if name.endswith("weight") else 2)
        if stacked or match["agent"] not in (None, "0"):
            raise InputError(
                "each agent has its own parameters (share_policy_params=False), but a policy here is one "
                "network for all agents: train with share_policy_params=True."
            )
        scaled = scaled or match["scaled"] is not None
        models.setdefault(int(match["model"] or 0), {})[match["tensor"]] = tensor
    return scaled, [models[k] for k in sorted(models)]


def _selection(settings: Settings, obs_dim: int) -> list[Linear]:
    """The map from an observation to the actor's inputs, unless they are the same."""
    if settings.inputs is None:
        return []
    last = max(settings.inputs, default=-1)
    if not 0 <= last < obs_dim or min(settings.inputs) < 0:
        raise InputError(
            f"--inputs has entries {shown(settings.inputs)} of an observation of {obs_dim} entries: give "
            f"numbers from 0 to {obs_dim - 1}."
        )
    matrix = torch.nn.functional.one_hot(torch.tensor(settings.inputs), obs_dim).float()
    return [Linear(matrix, torch.zeros(len(matrix)))]


def _steps(model: Mapping[str, Tensor], settings: Settings) -> list[Step]:
    if "0.weight" not in model:
        return [_conv(model, settings)]
    steps: list[Step] = []
    for k in range(0, 2 * len(model), 2):
        weight = model.get(f"{k}.weight")
        if weight is None or weight.dim() != 2:
            break
        bias = model.get(f"{k}.bias", torch.zeros(len(weight)))
        if bias.shape == weight.shape[:1]:
            steps += [Activated(), Linear(weight, bias)]
    known = {f"{k}.{part}" for k in range(0, len(steps), 2) for part in ("weight", "bias")}
    if model.keys() - known:
        raise InputError(
            f"an MLP of the actor has tensor {shown(min(model.keys() - known))}, so it has a norm_class or "
            f"another layer_class than Linear: {AS_CODE}."
        )
    return steps[1:]


def _conv(tensors: Mapping[str, Tensor], settings: Settings) -> Conv:
    optional = {"bias", "lin_l.bias", "lin_r.bias", "res.weight", "lin_edge.weight", "att_edge"}
    names = tensors.keys() - optional
    if names not in ({"att", "lin_l.weight", "lin_r.weight"}, {"att_src", "att_dst", "lin.weight"}):
        raise InputError(
            f"the actor's GNN has tensors {shown(', '.join(sorted(names)))}, not those of GATv2Conv or "
            f"GATConv: {AS_CODE}."
        )
    for name, tensor in tensors.items():
        if tensor.dim() != (3 if name.startswith("att") else 1 if name.endswith("bias") else 2):
            raise InputError(
                f"tensor {shown(name)} of the GNN has shape {tuple(tensor.shape)}: save it again."
            )
    layer = Conv(tensors, _edges(tensors, settings))
    heads, width = layer.heads_and_width
    # BenchMARL's layers give as many numbers as a head is wide.
    biases = {"bias": width} | (
        {"lin_l.bias": heads * width, "lin_r.bias": heads * width} if layer.is_v2 else {}
    )
    return layer._replace(tensors={n: torch.zeros(size) for n, size in biases.items()} | dict(tensors))


def _edges(tensors: Mapping[str, Tensor], settings: Settings) -> EdgeFeatures | None:
    if "lin_edge.weight" not in tensors:
        return None
    if settings.inputs is None or not (settings.position or settings.velocity):
        raise InputError(
            "the actor's GNN has edge features, and the checkpoint does not tell of what: give --position "
            "and --velocity, the entries of position_key and velocity_key in our observation, and --inputs."
        )
    try:
        edges = EdgeFeatures(
            position=tuple(settings.position),
            velocity=tuple(settings.velocity),
            own="mean" if settings.loops == "layer" else "zero",
        )
    except ValidationError:
        raise InputError("--position or --velocity has invalid entries: give numbers from 0.") from None
    width = tensors["lin_edge.weight"].shape[-1]
    if edges.width != width:
        raise InputError(
            f"the actor's GNN gets {width} numbers with an edge, and --position and --velocity give "
            f"{edges.width}: offset and distance for a position, the difference for a velocity."
        )
    return edges


def _mapped(last: Step, mapping: str) -> tuple[ScaleKind, Linear]:
    """(the record's scale, the last map) that together give scales by BenchMARL's `scale_mapping`.

    Its softplus mappings differ from the record's by a number that the raw scales' bias absorbs.
    """
    assert isinstance(last, Linear)
    match = re.fullmatch(r"biased_softplus(?:_(\d+\.?\d*))?", mapping)
    at_zero = float(match[1] or 1.0) if match else 0.0
    if mapping != "softplus" and not TORCHRL_FLOOR < at_zero <= 100:
        raise InputError(
            f"a bundle has no scale mapping {shown(mapping)}, only softplus and biased_softplus_<x> with x "
            f"above {TORCHRL_FLOOR}, at most 100: {AS_CODE}."
        )
    shift = math.log(math.expm1(at_zero - TORCHRL_FLOOR)) - TORCHRL_BIAS if match else -SCALE_BIAS
    bias = last.bias.clone()
    bias[len(bias) // 2 :] += shift
    return "torchrl" if match else "softplus", Linear(last.weight, bias)
