"""`xmarl-bench convert`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from xmarl_bench.cli.options import TrustCode

benchmarl_option = partial(typer.Option, rich_help_panel="With --from benchmarl, without its config.pkl")


def convert(
    weights: Annotated[
        Path,
        typer.Argument(
            help="State dict of torch.save, safetensors, checkpoint.zip of xmarl-train, or a checkpoint of "
            "BenchMARL."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder of the bundle to write; without it, list the tensors.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the policy; the folder's by default.")] = None,
    task: Annotated[str | None, typer.Option(help="Task it was trained for, or module:factory.")] = None,
    agents: Annotated[int, typer.Option(help="Team size it was trained for.")] = 3,
    architecture: Annotated[
        Path | None,
        typer.Option(help="Architecture record as JSON; checkpoints of xmarl-train hold their own."),
    ] = None,
    key_map: Annotated[
        Path | None,
        typer.Option(help="JSON object: prefix of tensor names -> new prefix, or null to drop the tensors."),
    ] = None,
    attention_entropy: Annotated[
        float, typer.Option(help="Weight lambda of the attention-entropy term in training.")
    ] = 0.0,
    training_seed: Annotated[int | None, typer.Option(help="Seed of its training.")] = None,
    source: Annotated[
        Literal["benchmarl"] | None,
        typer.Option(
            "--from", help="Read the actor of this library's checkpoint; no architecture is needed."
        ),
    ] = None,
    activation: Annotated[
        str | None,
        benchmarl_option(help="Activation function of its MLPs, e.g. tanh."),
    ] = None,
    loops: Annotated[
        Literal["layer", "graph", "none"] | None,
        benchmarl_option(
            metavar="HOW",
            help="What lets agents hear themselves: the layer's add_self_loops (layer; True by default), "
            "only BenchMARL's self_loops (graph), or nothing (none).",
        ),
    ] = None,
    scale_mapping: Annotated[
        str | None,
        benchmarl_option(help="Its scale_mapping; biased_softplus_1.0 by default."),
    ] = None,
    tanh_normal: Annotated[
        bool | None,
        benchmarl_option("--tanh-normal/--no-tanh-normal", help="Its use_tanh_normal; True by default."),
    ] = None,
    group: Annotated[str | None, benchmarl_option(help="Group of agents, if it has several.")] = None,
    inputs: Annotated[
        str | None,
        benchmarl_option(
            help="The entry of our observation that each input of the actor is, such as 4,5,0,1,2,3: keys of "
            "BenchMARL's observation in sequence, then position_key and velocity_key. By default as ours."
        ),
    ] = None,
    position: Annotated[
        str,
        benchmarl_option(help="Entries of our observation for position_key, such as 0,1."),
    ] = "",
    velocity: Annotated[
        str,
        benchmarl_option(help="Entries of our observation for velocity_key, such as 2,3."),
    ] = "",
    radius: Annotated[
        float | None,
        benchmarl_option(
            help="edge_radius of the topology from_pos, or inf for the topology full; asked for if the GNN "
            "gets positions."
        ),
    ] = None,
    trust_code: TrustCode = False,
) -> None:
    """Convert weights saved by other tools to a policy bundle. Executes nothing in the file."""
    from xmarl_bench.cli.fitted_table import print_table
    from xmarl_bench.counted import counted
    from xmarl_bench.errors import InputError
    from xmarl_bench.policy import build_policy
    from xmarl_bench.policy import convert as reading
    from xmarl_bench.policy.benchmarl import Settings, read_actor
    from xmarl_bench.policy.benchmarl_config import completed
    from xmarl_bench.policy.bundle import packed, write_bundle
    from xmarl_bench.policy.shapes import weight_shapes
    from xmarl_bench.rollout.cell import Cell
    from xmarl_bench.scoring.arguments import check_fit
    from xmarl_bench.tasks.sources import open_task

    if out is not None and out.exists():
        raise InputError(f"{out} already exists: choose another folder with --out, or remove it.")
    settings = Settings(
        activation,
        loops,
        scale_mapping,
        tanh_normal,
        group,
        None if inputs is None else _entries(inputs),
        _entries(position),
        _entries(velocity),
        radius,
    )
    if source is None and settings != Settings():
        raise InputError(
            "--activation, --loops, --scale-mapping, --tanh-normal, --group, --inputs, --position, "
            "--velocity and --radius are for --from benchmarl: give it, or leave them out."
        )
    if source is not None and not (architecture is None and key_map is None):
        raise InputError(
            "--from reads names and architecture itself: leave out --architecture and --key-map."
        )
    tensors = reading.read_tensors(weights)
    record = None if architecture is None else reading.read_architecture(architecture)
    if out is None:
        print_table([{"tensor": key, "shape": str(tuple(t.shape))} for key, t in tensors.items()])
        if record is not None:
            expected = weight_shapes(record).items()
            print_table([{"expected tensor": key, "shape": str(shape)} for key, shape in expected])
        return
    if task is None:
        raise InputError("a bundle needs the task that its policy was trained for: give --task.")
    opened = open_task(task, trust_code=trust_code)
    task = opened.name
    if source is not None:
        record, ours = read_actor(tensors, completed(settings, weights), opened.make(agents).obs_dim)
    else:
        record, ours = reading.renamed_weights(weights, tensors, record, key_map)
    policy = build_policy(record, reading.dense(ours, weight_shapes(record)))
    card, data = packed(
        policy,
        name=out.resolve().name if name is None else name,
        task=task,
        n_agents=agents,
        attention_entropy=attention_entropy,
        training_seed=training_seed,
        training={"converted_from": weights.name} | ({} if source is None else {"library": source}),
    )
    check_fit(card, Cell(task, agents))
    write_bundle(out, card, data)
    left_out = f", {len(tensors) - len(ours)} dropped" if source is None else f" from {source}'s actor"
    print(f"{out}: policy {card.name!r} of {counted(len(ours), 'tensor')}{left_out}.")


def _entries(text: str) -> tuple[int, ...]:
    from xmarl_bench.errors import InputError
    from xmarl_bench.records.strict_json import shown

    parts = text.split(",") if text else []
    if not all(part.strip().isdecimal() and len(part) < 6 for part in parts):
        raise InputError(f"{shown(text)} is not a list of entries: give numbers with commas, such as 0,1.")
    return tuple(int(part) for part in parts)
