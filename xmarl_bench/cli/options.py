"""Options that several commands take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

Tasks = Annotated[list[str], typer.Option("--task", help="Task, or 'all'. Repeatable.")]
Agents = Annotated[
    list[str], typer.Option("--agents", help="Team size, or 'all': each policy's own. Repeatable.")
]
Policies = Annotated[
    list[str],
    typer.Option(
        "--policy",
        help="Policy name, folder or zip of a bundle, module:factory, 'all', 'finished': all but checkpoints "
        "along training, a family ('residual', 'paper'), or 'default': the best residual seed of each task, "
        "team size and with or without regulariser. Repeatable.",
    ),
]
Explainers = Annotated[
    list[str],
    typer.Option(
        "--explainer", help="Explainer name, path/to/file.py:Name, module:Name, or 'all'. Repeatable."
    ),
]
Episodes = Annotated[int, typer.Option(help="Episodes per policy.")]
MaxCycles = Annotated[int | None, typer.Option(help="Steps per episode; the task's own number by default.")]
Seed = Annotated[int, typer.Option(help="Chooses the episodes, and seeds the explainers.")]
Jobs = Annotated[
    int | None,
    typer.Option(
        help="Processes, none of which changes a result; 1 by default, with --backend every worker there is."
    ),
]
Backend = Annotated[
    Literal["loky", "ray", "dask"],
    typer.Option(help="Where processes run: on this machine (loky), or on a cluster of Ray or Dask."),
]
Address = Annotated[
    str | None,
    typer.Option(help="host:port of the cluster of --backend; one is started on this machine by default."),
]
Parallel = Annotated[int, typer.Option(help="Episodes stepped side by side in a process. Changes no result.")]
TrustCode = Annotated[
    bool,
    typer.Option(
        "--trust-code",
        help="Take policies that bring code of their own (module:factory, or a package's), and run it.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
CacheFolder = Annotated[
    Path,
    typer.Option("--cache", envvar="XMARL_BENCH_CACHE", help="Folder of the cache that all runs share."),
]
Resume = Annotated[
    bool, typer.Option(help="Take pieces from the cache; with --no-resume they are computed again.")
]
