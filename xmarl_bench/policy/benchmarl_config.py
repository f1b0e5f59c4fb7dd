"""What BenchMARL's config.pkl records of an actor, beside the checkpoints of an experiment.

The file holds, one after the other: task, task's configuration, algorithm, model of the actor, and more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from xmarl_bench.errors import InputError, a_type
from xmarl_bench.policy.benchmarl import Settings
from xmarl_bench.policy.network import ACTIVATIONS
from xmarl_bench.policy.pickled_records import PickledName, PickledRecord, read_records
from xmarl_bench.policy.sequence import AS_CODE
from xmarl_bench.policy.untrusted import read_file
from xmarl_bench.records.strict_json import shown

MAX_BYTES = 1024 * 1024
ADDS_LOOPS = ("GATv2Conv", "GATConv")  # unless add_self_loops=False
# Arguments of layers that names and shapes of tensors show, or that have no effect on a trained policy.
SHOWN = {"heads", "concat", "residual", "bias", "share_weights", "add_self_loops", "dropout"}


def completed(settings: Settings, checkpoint: Path) -> Settings:
    """The settings, with those that are missing from the config.pkl of the checkpoint's experiment.

    Returns them unchanged if there is no such file, or if it has another form. Raises InputError for a
    configuration that a bundle cannot express.
    """
    path = checkpoint.resolve().parent.parent / "config.pkl"
    if not path.is_file():
        return settings
    try:
        _, _, algorithm, model, *_ = read_records(read_file(path, MAX_BYTES))
    except ValueError:
        return settings
    if not (isinstance(algorithm, PickledRecord) and isinstance(model, PickledRecord)):
        return settings
    scale, tanh_normal = (algorithm.fields.get(name) for name in ("scale_mapping", "use_tanh_normal"))
    recorded = Settings(
        activation=_activation(model),
        loops=_loops(model),
        radius=_radius(model),
        scale_mapping=scale if isinstance(scale, str) else None,
        use_tanh_normal=tanh_normal if isinstance(tanh_normal, bool) else None,
    )
    missing = {name: value for name, value in recorded._asdict().items() if getattr(settings, name) is None}
    return settings._replace(**missing)


def _models(model: PickledRecord, with_field: str) -> Iterator[dict[str, Any]]:
    """The configurations of GNNs (with gnn_class) or MLPs (with activation_class), in sequence."""
    parts = model.fields.get("model_configs", [model])
    for part in parts if isinstance(parts, list) else []:
        if isinstance(part, PickledRecord) and with_field in part.fields:
            yield part.fields


def _activation(model: PickledRecord) -> str | None:
    ours = {kind.__name__: name for name, kind in ACTIVATIONS.items()}
    found = {_name(part["activation_class"]) for part in _models(model, "activation_class")}
    arguments = any(part.get("activation_kwargs") for part in _models(model, "activation_class"))
    if len(found) > 1 or not found <= ours.keys() or arguments:
        what = " with arguments" if arguments else ""
        raise InputError(
            f"the actor's MLPs have the activation functions {shown(', '.join(sorted(found)))}{what}, and a "
            f"bundle has one of {', '.join(ours)} for all: {AS_CODE}."
        )
    return ours[found.pop()] if found else None


def _loops(model: PickledRecord) -> Any:
    found = set()
    for part in _models(model, "gnn_class"):
        arguments, kind = part.get("gnn_kwargs") or {}, _name(part["gnn_class"])
        arguments = arguments if isinstance(arguments, dict) else {"an unknown value": arguments}
        other = sorted(str(name) for name in arguments.keys() - SHOWN)
        if other:
            raise InputError(
                f"the actor's GNN has gnn_kwargs {shown(', '.join(other))}, which a bundle cannot express: "
                f"{AS_CODE}."
            )
        if arguments.get("add_self_loops", True) and kind in ADDS_LOOPS:
            found.add("layer")
        else:
            found.add("graph" if part.get("self_loops") else "none")
    if len(found) > 1:
        raise InputError(f"only some of the actor's GNNs have self loops: {AS_CODE}.")
    return found.pop() if found else None


def _radius(model: PickledRecord) -> float | None:
    found: set[float] = set()
    for part in _models(model, "gnn_class"):
        topology, radius = part.get("topology"), part.get("edge_radius")
        if topology == "full":
            found.add(math.inf)
        elif topology == "from_pos" and isinstance(radius, int | float):
            found.add(float(radius))
        else:
            raise InputError(f"the actor's GNN has the topology {_name(topology)}: {AS_CODE}.")
    if len(found) > 1:
        raise InputError(f"the actor's GNNs have different topologies: {AS_CODE}.")
    return found.pop() if found else None


def _name(value: Any) -> str:
    """Of a class, or a text. Any other value of a hostile file may be too large to show."""
    if isinstance(value, PickledName):
        return value.name
    return shown(value) if isinstance(value, str) else a_type(value)
