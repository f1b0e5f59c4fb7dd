"""`xmarl-train`: train one policy with MAPPO, with progress, checkpoints and resume."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from xmarl_baselines.reference import EPISODES, GROUPS, finished_bundle, planned_runs, run_named
from xmarl_baselines.training.allocator import keep_freed_memory
from xmarl_baselines.training.families import FAMILIES, Family
from xmarl_baselines.training.own_process import train_in_own_process
from xmarl_baselines.training.recipes import Recipe, recipe_for
from xmarl_baselines.training.trainer import Report, Run, train
from xmarl_bench.cli.fitted_table import print_table
from xmarl_bench.cli.options import Address, Backend, Device
from xmarl_bench.cli.program import Version
from xmarl_bench.cli.program import run as run_program
from xmarl_bench.cli.score_table import performance_rows
from xmarl_bench.errors import InputError
from xmarl_bench.parallel.fan_out import Failure, fan_out
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.policy import PolicyCard, save_policy
from xmarl_bench.policy.device import CPU, checked_device
from xmarl_bench.reproducible import one_thread
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.evaluation import Performance, evaluate_policy

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

# Options of a run with --task, and of --reproduce with a group.
OF_A_RUN = (
    "family",
    "agents",
    "attention_entropy",
    "attention_start",
    "seed",
    "caution",
    "frames",
    "start_from",
    "episodes",
    "device",
)
OF_MANY = ("jobs", "backend", "address")


@app.command()
def command(
    context: typer.Context,
    task: Annotated[
        str | None, typer.Option(help="blind_navigation_v0, blind_passage_v0 or blind_discovery_v0")
    ] = None,
    reproduce: Annotated[
        str | None,
        typer.Option(
            help="a policy to train exactly as it was, `all` reference policies, or those of a `dose`"
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            help="trainings side by side, with --reproduce all; by default 1, with --backend every worker"
        ),
    ] = None,
    backend: Backend = "loky",
    address: Address = None,
    family: Annotated[
        Family, typer.Option(help="network: `paper`, or the same with a residual connection")
    ] = FAMILIES[0],
    agents: Annotated[int, typer.Option(help="team size N")] = 3,
    attention_entropy: Annotated[
        float, typer.Option(min=0, help="lambda of the attention-entropy term")
    ] = 0.0,
    attention_start: Annotated[
        float | None,
        typer.Option(min=0, max=1, help="share of training before that term starts; default: the recipe's"),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="training seed")] = 0,
    caution: Annotated[
        float, typer.Option(min=0, help="multiplies the penalties for touching and for being near")
    ] = 1.0,
    frames: Annotated[int | None, typer.Option(min=1, help="team-steps; default: the recipe's")] = None,
    out: Annotated[Path, typer.Option(help="folder in which each run gets its own folder")] = Path("runs"),
    start_from: Annotated[
        Path | None, typer.Option(help="folder of a finished run to fine-tune, e.g. with another lambda")
    ] = None,
    resume: Annotated[bool, typer.Option(help="continue an interrupted run")] = False,
    device: Device = CPU,
    episodes: Annotated[int, typer.Option(min=1, help="episodes of the evaluation at the end")] = EPISODES,
    version: Version = False,
) -> None:
    """Train one graph-attention policy and write it as a bundle that `xmarl-bench score --policy` takes."""
    if (task is None) == (reproduce is None):
        raise InputError(
            "give either --task, to train a policy of your own, or --reproduce NAME, or --reproduce all."
        )
    if reproduce is not None:
        _refuse(context, OF_A_RUN, "trains a policy as it was; to change something, train one with --task")
    if reproduce in GROUPS:
        raise typer.Exit(train_missing(GROUPS[reproduce](), out, Workers(jobs, backend, address)))
    _refuse(context, OF_MANY, "trains one policy; side by side are those of --reproduce all")
    if task is None:
        assert reproduce is not None
        run = run_named(reproduce)
    else:
        Cell(task, agents)  # raises if the task does not take a team of this size
        recipe = recipe_for(task, agents, family=family)
        if start_from is not None:
            _check_start(start_from, agents, recipe)
            recipe = recipe.fine_tuning()
        if frames is not None:
            recipe = replace(recipe, frames=frames)
        if attention_start is not None:
            recipe = replace(recipe, attention_start=attention_start)
        if caution != 1.0 and recipe.shaping.with_caution(caution) == recipe.shaping:
            raise InputError(f"{task} is trained without penalties for touching agents: leave --caution out.")
        start = None if start_from is None else start_from.resolve().name
        run = Run(recipe, agents, attention_entropy, seed, caution, start)
    place, folder = checked_device(device), out / run.name
    card = train_and_save(run, folder, resume=resume, start_from=start_from, episodes=episodes, device=place)
    print_table(performance_rows([card], [Performance(**card.performance)]), keep=("success",))
    print(f"policy in {folder / 'policy'}: xmarl-bench score --policy {folder / 'policy'}")


def _refuse(context: typer.Context, options: tuple[str, ...], why: str) -> None:
    """Raises InputError if one of the options was given."""
    for option in options:
        source = context.get_parameter_source(option)
        if source is not None and source.name != "DEFAULT":
            given = "task" if context.params["reproduce"] is None else "reproduce"
            name = option.replace("_", "-")
            raise InputError(f"--{given} {context.params[given]} {why}: leave out --{name}.")


def train_missing(names: Iterable[str], out: Path, workers: Workers) -> int:
    """Train the policies that are not finished in `out`, each in a process; returns the exit code.

    Runs begun earlier are resumed. A failed run does not stop the others; its output is in `out`/NAME.log.
    Workers on other machines need `out` on a file system that all share. Raises InputError for an unknown
    name, and if `out` holds another run of one of these names.
    """
    missing = [name for name in names if finished_bundle(run_named(name), out) is None]
    out.mkdir(parents=True, exist_ok=True)
    console = Console(stderr=True)
    failed = 0
    units = [(name, out.resolve()) for name in missing]
    for done, (k, code) in enumerate(fan_out(train_in_own_process, units, workers=workers), start=1):
        outcome = "trained"
        if code != 0:
            failed += 1
            outcome = f"FAILED, {code.error}" if isinstance(code, Failure) else "FAILED, see its log"
        console.print(f"{done} of {len(missing)}: {missing[k]} {outcome}", highlight=False)
    return 1 if failed else 0


def _check_start(folder: Path, agents: int, recipe: Recipe) -> None:
    """Raises InputError if `folder` is not a run of the same task, team size, family and critic."""
    try:
        settings = json.loads((folder / "settings.json").read_bytes())
        team, began = settings["n_agents"], settings["recipe"]
        trained = (began["task"], team, began["family"], tuple(began["critic"]))
    except (OSError, ValueError, KeyError, TypeError):
        trained = None
    if trained is None or not (folder / "checkpoint.zip").exists():
        raise InputError(f"{folder} holds no run with a checkpoint: give the folder of a run to start from.")
    wanted = (recipe.task, agents, recipe.family, recipe.critic)
    if trained != wanted:
        there, here = ("{}, {} agents, a {} network, a critic {}".format(*each) for each in (trained, wanted))
        raise InputError(f"{folder} is a run of {there}, not of {here}: start from a run of the same kind.")


def train_and_save(
    run: Run,
    folder: Path,
    *,
    resume: bool,
    start_from: Path | None,
    episodes: int,
    device: str = CPU,
) -> PolicyCard:
    """Train, measure on `episodes` deterministic episodes, and write RUN/policy; returns its card."""
    # Two runs side by side on one thread each are faster than one after the other on two.
    with one_thread(), _progress(run) as report:
        trained = train(run, folder, resume=resume, start_from=start_from, report=report, device=device)
    return save_policy(
        folder / "policy",
        trained.policy,
        name=run.name,
        task=run.recipe.task,
        n_agents=run.n_agents,
        attention_entropy=run.attention_entropy,
        family=run.recipe.family,
        training_seed=run.seed,
        initial_seed=run.seed if run.start_from is None else None,
        training={
            **run.settings(),
            "frames": trained.frames,
            "cpu_seconds": round(trained.seconds, 1),
            "validation": trained.validation,
            "curve": trained.curve,
            "command": command_of(run),
            **({} if device == CPU else {"device": device}),
        },
        performance=evaluate_policy(trained.policy, run.recipe.task, run.n_agents, episodes=episodes),
    )


def command_of(run: Run) -> str:
    """The command that trains this policy again, or that there is none: options reach a part of a recipe."""
    if planned_runs().get(run.name) == run:
        return f"xmarl-train --reproduce {run.name}"
    usual = recipe_for(run.recipe.task, run.n_agents, family=run.recipe.family)
    if run.start_from is not None:
        usual = usual.fine_tuning()
    frames, start = run.recipe.frames, run.recipe.attention_start
    if replace(usual, frames=frames, attention_start=start) != run.recipe:
        return "none: from Python, train_and_save(Run.from_settings(card.training), ...)"
    return (
        f"xmarl-train --task {run.recipe.task} --family {run.recipe.family} --agents {run.n_agents} "
        f"--attention-entropy {run.attention_entropy:g} --seed {run.seed} --frames {frames}"
        + ("" if start == usual.attention_start else f" --attention-start {start:g}")
        + ("" if run.caution == 1.0 else f" --caution {run.caution:g}")
        + ("" if run.start_from is None else f" --start-from runs/{run.start_from}")
    )


@contextmanager
def _progress(run: Run) -> Iterator[Report]:
    """Shows a progress bar on a terminal, or writes a line a minute to a log file."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[seen]}"),
        TimeElapsedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    last_line = time.monotonic()
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task(run.name, total=run.recipe.frames, seen="")

        def report(frames: int, log: dict[str, float]) -> None:
            nonlocal last_line
            seen = f"{frames / 1e6:.1f} of {run.recipe.frames / 1e6:.1f} M frames"
            if "rollout/is_success" in log:
                seen += f", success {log['rollout/is_success']:.2f} while exploring"
            progress.update(bar, completed=frames, seen=seen)
            if not console.is_terminal and time.monotonic() - last_line > 60:
                last_line = time.monotonic()
                console.print(f"{run.name}: {seen}", highlight=False)

        yield report


def main() -> None:
    """Console entry point."""
    keep_freed_memory()
    run_program("xmarl-train", app, "stopped. The same command continues; a single run needs --resume.")


if __name__ == "__main__":
    main()
