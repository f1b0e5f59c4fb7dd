"""Options shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

Tasks = Annotated[
    list[str],
    typer.Option("--task", help="Task, path/to/file.py:factory, module:factory, or 'all'. Repeatable."),
]
Agents = Annotated[
    list[str], typer.Option("--agents", help="Team size, or 'all': each policy's own. Repeatable.")
]
Teams = Annotated[
    list[int],
    typer.Option(
        "--team",
        help="Team size that the chosen policies play in, in place of the one they were trained for "
        "(zero-shot). Repeatable.",
    ),
]
Policies = Annotated[
    list[str],
    typer.Option(
        "--policy",
        help="Policy name, folder or zip of a bundle, module:factory, 'all', 'finished' (all but checkpoints "
        "along training), a family ('residual', 'paper'), or 'default' (the best residual seed for each task "
        "and team size, with and without regulariser). Repeatable.",
    ),
]
Explainers = Annotated[
    list[str],
    typer.Option(
        "--explainer", help="Explainer name, path/to/file.py:Name, module:Name, or 'all'. Repeatable."
    ),
]
Episodes = Annotated[int, typer.Option(help="Episodes per policy.")]
MaxCycles = Annotated[int | None, typer.Option(help="Steps per episode; the task's default if not given.")]
Seed = Annotated[int, typer.Option(help="Seed of the episodes and of the explainers.")]
Jobs = Annotated[
    int | None,
    typer.Option(help="Processes; 1 by default, or every worker of a cluster. Changes no result."),
]
Backend = Annotated[
    Literal["loky", "ray", "dask"],
    typer.Option(help="Where processes run: on this machine (loky), or on a Ray or Dask cluster."),
]
Address = Annotated[
    str | None,
    typer.Option(help="host:port of the cluster of --backend; by default, start one on this machine."),
]
Parallel = Annotated[int, typer.Option(help="Episodes stepped in parallel in a process. Changes no result.")]
TrustCode = Annotated[
    bool,
    typer.Option(
        "--trust-code",
        help="Run the code of policies and tasks that have their own (module:factory, or of an installed "
        "package).",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
CacheFolder = Annotated[
    Path,
    typer.Option("--cache", envvar="XMARL_BENCH_CACHE", help="Folder of the cache that all runs share."),
]
Resume = Annotated[bool, typer.Option(help="Use pieces in the cache; --no-resume computes them again.")]
