"""Options shared by several commands."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

# Options by their group in --help.
what_option = partial(typer.Option, rich_help_panel="What")
how_much_option = partial(typer.Option, rich_help_panel="How much")
where_option = partial(typer.Option, rich_help_panel="Where results go")
cluster_option = partial(typer.Option, rich_help_panel="Processes and cluster")

Tasks = Annotated[
    list[str],
    what_option(
        "--task", metavar="NAME", help="Task, path/to/file.py:factory, module:factory, or 'all'. Repeatable."
    ),
]
Agents = Annotated[
    list[str],
    what_option("--agents", metavar="N", help="Team size, or 'all': each policy's own. Repeatable."),
]
Teams = Annotated[
    list[int],
    what_option(
        "--team",
        metavar="N",
        help="Team size that the chosen policies play in, in place of the one they were trained for "
        "(zero-shot). Repeatable.",
    ),
]
Policies = Annotated[
    list[str],
    what_option(
        "--policy",
        metavar="NAME",
        help="Policy name, folder or zip of a bundle, module:factory, 'all', 'finished' (all but checkpoints "
        "along training), a family ('residual', 'paper'), or 'default' (the best residual seed for each task "
        "and team size, with and without regulariser). Repeatable.",
    ),
]
Explainers = Annotated[
    list[str],
    what_option(
        "--explainer",
        metavar="NAME",
        help="Explainer name, path/to/file.py:Name, module:Name, or 'all'. Repeatable.",
    ),
]
TrustCode = Annotated[
    bool,
    what_option(
        "--trust-code",
        help="Run the code of policies and tasks that have their own (module:factory, or of an installed "
        "package).",
    ),
]
Episodes = Annotated[int, how_much_option(help="Episodes per policy.")]
Timesteps = Annotated[
    int | None,
    how_much_option(help="At most so many evenly spaced timesteps of each episode; all by default."),
]
MaxCycles = Annotated[
    int | None,
    how_much_option(help="Steps per episode; the task's default if not given."),
]
Seed = Annotated[int, how_much_option(help="Seed of the episodes and of the explainers.")]
Submitter = Annotated[str | None, where_option(help="Name of the submitter, for the entries.")]
CacheFolder = Annotated[
    Path,
    where_option("--cache", envvar="XMARL_BENCH_CACHE", help="Folder of the cache that all runs share."),
]
Resume = Annotated[
    bool,
    where_option(help="Use pieces in the cache; --no-resume computes them again."),
]
Jobs = Annotated[
    int | None,
    cluster_option(help="Processes; 1 by default, or every worker of a cluster. Changes no result."),
]
Backend = Annotated[
    Literal["loky", "ray", "dask"],
    cluster_option(help="Where processes run: on this machine (loky), or on a Ray or Dask cluster."),
]
Address = Annotated[
    str | None,
    cluster_option(help="host:port of the cluster of --backend; by default, start one on this machine."),
]
Device = Annotated[
    str,
    cluster_option(
        help="Where training or explainers that iterate compute: cpu, cuda or mps. Only the CPU repeats bit "
        "for bit."
    ),
]
Parallel = Annotated[
    int,
    cluster_option(help="Episodes stepped in parallel in a process. Changes no result."),
]
Isolate = Annotated[
    bool,
    how_much_option(
        help="Run explainers that are not shipped, and policies and tasks that are code, in processes of "
        "their own. --no-isolate runs them in this process, to debug them: entries say so, and nothing is "
        "kept in the cache."
    ),
]
AnswerSeconds = Annotated[
    float,
    how_much_option(
        help="Seconds in which such a process must answer: an explainer for an episode, a policy for a batch "
        "of masks, a task for a step."
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
