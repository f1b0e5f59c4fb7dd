"""The command line: parses, calls, prints. What is wrong with the input is one sentence and exit code 2."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from xmarl_bench.errors import InputError

app = typer.Typer(
    name="xmarl-bench",
    help="Scores explainers of multi-agent graph-attention policies.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Tasks = Annotated[list[str], typer.Option("--task", help="Task, or 'all'. Repeatable.")]
Agents = Annotated[
    list[str], typer.Option("--agents", help="Team size, or 'all': each policy's own. Repeatable.")
]
Policies = Annotated[
    list[str],
    typer.Option("--policy", help="Policy name or folder of a policy bundle, or 'all'. Repeatable."),
]
Explainers = Annotated[list[str], typer.Option("--explainer", help="Explainer name, or 'all'. Repeatable.")]
Episodes = Annotated[int, typer.Option(help="Episodes per policy.")]
MaxCycles = Annotated[int | None, typer.Option(help="Steps per episode; the task's own number by default.")]
Seed = Annotated[int, typer.Option(help="Chooses the episodes, and seeds the explainers.")]
Jobs = Annotated[int, typer.Option(help="Processes. Changes no result.")]
Parallel = Annotated[int, typer.Option(help="Episodes stepped side by side in a process. Changes no result.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


class Kind(StrEnum):
    tasks = "tasks"
    policies = "policies"
    explainers = "explainers"


@app.command()
def score(
    task: Tasks = ["all"],  # noqa: B006
    agents: Agents = ["all"],  # noqa: B006
    policy: Policies = ["all"],  # noqa: B006
    explainer: Explainers = ["all"],  # noqa: B006
    episodes: Episodes = 50,
    timesteps: Annotated[
        int | None,
        typer.Option(help="At most so many evenly spaced timesteps of each episode; all by default."),
    ] = None,
    slow_episodes: Annotated[
        int | None, typer.Option(help="Episodes for explainers that declare themselves slow.")
    ] = None,
    slow_timesteps: Annotated[
        int | None, typer.Option(help="Timesteps per episode for explainers that declare themselves slow.")
    ] = None,
    behaviour_episodes: Annotated[
        int | None,
        typer.Option(
            help="Episodes that the team also plays on the explanation; all by default, none for explainers "
            "that declare themselves slow."
        ),
    ] = None,
    no_behaviour: Annotated[
        list[str],
        typer.Option(help="Explainer on whose masks the team does not play, or 'all'. Repeatable."),
    ] = [],  # noqa: B006
    max_cycles: MaxCycles = None,
    seed: Seed = 0,
    jobs: Jobs = 1,
    parallel_episodes: Parallel = 50,
    submitter: Annotated[str | None, typer.Option(help="Who makes these entries.")] = None,
    out: Annotated[Path, typer.Option(help="Where entries/ and leaderboard.json go.")] = Path("leaderboard"),
) -> None:
    """Score explainers on policies; write one entry per pair and rebuild the leaderboard.

    With --slow-episodes or --slow-timesteps, slow explainers are scored on fewer states only, and all
    others on both: on all states, and on the same few, so that they can be compared.
    """
    from dataclasses import replace

    from xmarl_bench import report
    from xmarl_bench.board import build_board
    from xmarl_bench.entry import read_entries, write_entry
    from xmarl_bench.files import check_writable
    from xmarl_bench.request import Sampling
    from xmarl_bench.scoring import score_requests
    from xmarl_bench.selection import plan, select_explainers, select_policies

    sampling = Sampling(episodes=episodes, timesteps=timesteps, max_cycles=max_cycles, seed=seed)
    slow = replace(
        sampling,
        episodes=episodes if slow_episodes is None else min(episodes, slow_episodes),
        timesteps=min((t for t in (timesteps, slow_timesteps) if t is not None), default=None),
    )
    explainers = select_explainers(explainer)
    requests = plan(
        select_policies(policy, task, agents),
        explainers,
        sampling,
        slow,
        behaviour_episodes=behaviour_episodes,
        no_behaviour=no_behaviour,
    )
    check_writable(out)
    read_entries(out / "entries")  # a board that could not be rebuilt afterwards is refused now
    entries = []
    try:
        for entry in score_requests(
            requests, jobs=jobs, parallel_episodes=parallel_episodes, progress=True, submitter=submitter
        ):
            path = write_entry(out / "entries", entry)
            entries.append(entry)
            if not sys.stderr.isatty():  # a log, which shows no progress bar
                print(f"{len(entries)} of {len(requests)}: {path}", flush=True)
    finally:
        if entries:  # an interrupted run keeps what it finished
            board = build_board(out)
    report.print_scores(entries, [found.explainer for found in explainers])
    print(f"{len(entries)} entries in {out / 'entries'}, leaderboard in {board} and {out / 'index.html'}.")


@app.command("list")
def list_(kind: Annotated[Kind, typer.Argument(help="What to list.")], as_json: AsJson = False) -> None:
    """List tasks, policies or explainers."""
    from xmarl_bench import report

    rows = {Kind.tasks: report.tasks, Kind.policies: report.policies, Kind.explainers: report.explainers}[
        kind
    ]()
    if as_json:
        _print_json(rows)
    else:
        report.print_rows(rows)


@app.command()
def evaluate(
    task: Tasks = ["all"],  # noqa: B006
    agents: Agents = ["all"],  # noqa: B006
    policy: Policies = ["all"],  # noqa: B006
    episodes: Episodes = 50,
    max_cycles: MaxCycles = None,
    seed: Seed = 0,
    jobs: Jobs = 1,
    parallel_episodes: Parallel = 50,
    as_json: AsJson = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table of the README.")] = False,
) -> None:
    """Measure how well policies do their task, with messages between agents and without."""
    from xmarl_bench import report
    from xmarl_bench.evaluation import evaluate as run
    from xmarl_bench.request import Sampling
    from xmarl_bench.selection import select_policies

    selected = select_policies(policy, task, agents)
    pairs = [(network, card, cell) for network, card, cells in selected for cell in cells]
    performances = run(
        [(network, cell) for network, _, cell in pairs],
        Sampling(episodes=episodes, max_cycles=max_cycles, seed=seed),
        jobs=jobs,
        parallel_episodes=parallel_episodes,
        progress=True,
    )
    cards = [card for _, card, _ in pairs]
    if as_json:
        _print_json(
            [{"policy": card.name, **each.record()} for card, each in zip(cards, performances, strict=True)]
        )
        return
    rows = report.performance_rows(cards, performances)
    if markdown:
        print(report.markdown(rows))
    else:
        report.print_rows(rows)


@app.command()
def render(
    task: Annotated[str | None, typer.Option(help="Task; the policy's own by default.")] = None,
    policy: Annotated[
        str, typer.Option(help="Policy name or folder of a policy bundle, 'heuristic' or 'random'.")
    ] = "heuristic",
    explainer: Annotated[str | None, typer.Option(help="Explainer to draw over the team.")] = None,
    agents: Annotated[int | None, typer.Option(help="Team size; the policy's own by default, or 3.")] = None,
    seed: Annotated[int, typer.Option(help="As of `score`, whose episodes these are.")] = 0,
    episode: Annotated[int, typer.Option(help="Which of the episodes that `score` plays, from 0.")] = 0,
    max_cycles: MaxCycles = None,
    out: Annotated[
        Path, typer.Option(help="File to write: .gif, .mp4, or .png, a sheet of six moments.")
    ] = Path("episode.gif"),
) -> None:
    """Draw an episode, and over it who influences whom according to an explainer."""
    from xmarl_bench.animation import check_target, write_animation
    from xmarl_bench.recording import record
    from xmarl_bench.registry import find_explainer
    from xmarl_bench.selection import select_team

    check_target(out)
    network, name, cell = select_team(policy, task, agents)
    chosen = find_explainer(explainer).explainer if explainer is not None else None
    recording = record(cell.make(), name, network, seed=seed, episode=episode, max_cycles=max_cycles)
    written = write_animation(recording, out, chosen, progress=True)
    last = recording.track.scene()
    print(
        f"{out}: {written.frames} of {last.cycle + 1} moments of episode {recording.seed}, "
        f"{written.n_bytes / 1e6:.2f} MB; {last.ended}, success {recording.success_rate:.2f}, "
        f"return {last.total:.2f}."
    )


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, allow_nan=False))


def main() -> None:
    try:
        app()
    except InputError as error:
        print(f"xmarl-bench: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None


if __name__ == "__main__":
    main()
