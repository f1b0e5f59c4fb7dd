"""Options shared by several commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

# Groups of options in --help.
WHAT, HOW_MUCH = "What", "How much"
WHERE, RUNS_ON = "Where results go", "Processes and cluster"

Tasks = Annotated[
    list[str],
    typer.Option(
        "--task",
        metavar="NAME",
        help="Task, path/to/file.py:factory, module:factory, or 'all'. Repeatable.",
        rich_help_panel=WHAT,
    ),
]
Agents = Annotated[
    list[str],
    typer.Option(
        "--agents",
        metavar="N",
        help="Team size, or 'all': each policy's own. Repeatable.",
        rich_help_panel=WHAT,
    ),
]
Teams = Annotated[
    list[int],
    typer.Option(
        "--team",
        metavar="N",
        help="Team size that the chosen policies play in, in place of the one they were trained for "
        "(zero-shot). Repeatable.",
        rich_help_panel=WHAT,
    ),
]
Policies = Annotated[
    list[str],
    typer.Option(
        "--policy",
        metavar="NAME",
        help="Policy name, folder or zip of a bundle, module:factory, 'all', 'finished' (all but checkpoints "
        "along training), a family ('residual', 'paper'), or 'default' (the best residual seed for each task "
        "and team size, with and without regulariser). Repeatable.",
        rich_help_panel=WHAT,
    ),
]
Explainers = Annotated[
    list[str],
    typer.Option(
        "--explainer",
        metavar="NAME",
        help="Explainer name, path/to/file.py:Name, module:Name, or 'all'. Repeatable.",
        rich_help_panel=WHAT,
    ),
]
TrustCode = Annotated[
    bool,
    typer.Option(
        "--trust-code",
        help="Run the code of policies and tasks that have their own (module:factory, or of an installed "
        "package).",
        rich_help_panel=WHAT,
    ),
]
Episodes = Annotated[int, typer.Option(help="Episodes per policy.", rich_help_panel=HOW_MUCH)]
Timesteps = Annotated[
    int | None,
    typer.Option(
        help="At most so many evenly spaced timesteps of each episode; all by default.",
        rich_help_panel=HOW_MUCH,
    ),
]
MaxCycles = Annotated[
    int | None,
    typer.Option(help="Steps per episode; the task's default if not given.", rich_help_panel=HOW_MUCH),
]
Seed = Annotated[
    int, typer.Option(help="Seed of the episodes and of the explainers.", rich_help_panel=HOW_MUCH)
]
Submitter = Annotated[
    str | None, typer.Option(help="Name of the submitter, for the entries.", rich_help_panel=WHERE)
]
CacheFolder = Annotated[
    Path,
    typer.Option(
        "--cache",
        envvar="XMARL_BENCH_CACHE",
        help="Folder of the cache that all runs share.",
        rich_help_panel=WHERE,
    ),
]
Resume = Annotated[
    bool,
    typer.Option(help="Use pieces in the cache; --no-resume computes them again.", rich_help_panel=WHERE),
]
Jobs = Annotated[
    int | None,
    typer.Option(
        help="Processes; 1 by default, or every worker of a cluster. Changes no result.",
        rich_help_panel=RUNS_ON,
    ),
]
Backend = Annotated[
    Literal["loky", "ray", "dask"],
    typer.Option(
        help="Where processes run: on this machine (loky), or on a Ray or Dask cluster.",
        rich_help_panel=RUNS_ON,
    ),
]
Address = Annotated[
    str | None,
    typer.Option(
        help="host:port of the cluster of --backend; by default, start one on this machine.",
        rich_help_panel=RUNS_ON,
    ),
]
Device = Annotated[
    str,
    typer.Option(
        help="Where training or explainers that iterate compute: cpu, cuda or mps. Only the CPU repeats bit "
        "for bit.",
        rich_help_panel=RUNS_ON,
    ),
]
Parallel = Annotated[
    int,
    typer.Option(
        help="Episodes stepped in parallel in a process. Changes no result.", rich_help_panel=RUNS_ON
    ),
]
Isolate = Annotated[
    bool,
    typer.Option(
        help="Run explainers that are not shipped, and policies and tasks that are code, in processes of "
        "their own. --no-isolate runs them in this process, to debug them: entries say so, and nothing is "
        "kept in the cache.",
        rich_help_panel=HOW_MUCH,
    ),
]
AnswerSeconds = Annotated[
    float,
    typer.Option(
        help="Seconds in which such a process must answer: an explainer for an episode, a policy for a batch "
        "of masks, a task for a step.",
        rich_help_panel=HOW_MUCH,
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
