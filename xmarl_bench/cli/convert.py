"""`xmarl-bench convert`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def convert(
    weights: Annotated[
        Path,
        typer.Argument(help="State dict of torch.save, safetensors, or checkpoint.zip of xmarl-train."),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder of the bundle to write; without it, list the tensors.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the policy; the folder's by default.")] = None,
    task: Annotated[str | None, typer.Option(help="Task it was trained for.")] = None,
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
) -> None:
    """Convert weights saved by other tools to a policy bundle. Executes nothing in the file."""
    from pydantic import ValidationError

    from xmarl_bench.cli import tables
    from xmarl_bench.errors import InputError
    from xmarl_bench.policy import build_policy
    from xmarl_bench.policy import convert as reading
    from xmarl_bench.policy.bundle import packed, write_bundle
    from xmarl_bench.policy.shapes import weight_shapes
    from xmarl_bench.rollout.cell import Cell, check_task
    from xmarl_bench.scoring.request import check_fit

    if out is not None and out.exists():
        raise InputError(f"{out} already exists: choose another folder with --out, or remove it.")
    tensors = reading.read_tensors(weights)
    record = None if architecture is None else reading.read_architecture(architecture)
    if out is None:
        tables.print_rows([{"tensor": key, "shape": str(tuple(t.shape))} for key, t in tensors.items()])
        if record is not None:
            expected = weight_shapes(record).items()
            tables.print_rows([{"expected tensor": key, "shape": str(shape)} for key, shape in expected])
        return
    if task is None:
        raise InputError("a bundle needs the task that its policy was trained for: give --task.")
    check_task(task)
    recorded = reading.sb3_architecture(weights, tensors) if record is None else None
    record = record or recorded
    if record is None:
        raise InputError(f"{weights} does not hold an architecture: give --architecture.")
    shapes = weight_shapes(record)
    if key_map is not None:
        renamed = reading.rename(tensors, reading.read_key_map(key_map))
    elif recorded is not None:
        renamed = reading.rename(tensors, reading.SB3_KEYS)
    else:
        renamed = reading.recognised(tensors, shapes)
    policy = build_policy(record, reading.dense(renamed, shapes))
    try:
        card, data = packed(
            policy,
            name=out.resolve().name if name is None else name,
            task=task,
            n_agents=agents,
            attention_entropy=attention_entropy,
            training_seed=training_seed,
            training={"converted_from": weights.name},
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"the policy's {first['loc'][0]} is invalid: {first['msg']}.") from None
    check_fit(card, Cell(task, agents))
    write_bundle(out, card, data)
    left_out = len(tensors) - len(renamed)
    print(f"{out}: policy {card.name!r} of {len(renamed)} tensors, {left_out} dropped.")
