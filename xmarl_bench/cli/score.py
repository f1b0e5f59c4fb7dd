"""`xmarl-bench score`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from xmarl_bench.cli.options import (
    Address,
    Agents,
    AnswerSeconds,
    Backend,
    CacheFolder,
    Device,
    Episodes,
    Explainers,
    Isolate,
    Jobs,
    MaxCycles,
    Parallel,
    Policies,
    Resume,
    Seed,
    Submitter,
    Tasks,
    Teams,
    Timesteps,
    TrustCode,
    how_much_option,
    what_option,
    where_option,
)
from xmarl_bench.errors import InputError
from xmarl_bench.isolation.limits import UNLIMITED
from xmarl_bench.parallel.loading import without_collector
from xmarl_bench.scoring.cache import DEFAULT_FOLDER

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xmarl_bench.entry.schema import Entry
    from xmarl_bench.explain.explainer import Explainer


def score(
    task: Tasks = ["all"],  # noqa: B006
    agents: Agents = ["all"],  # noqa: B006
    team: Teams = [],  # noqa: B006
    policy: Policies = ["default"],  # noqa: B006
    explainer: Explainers = ["all"],  # noqa: B006
    episodes: Episodes = 50,
    timesteps: Timesteps = None,
    slow_episodes: Annotated[
        int | None,
        how_much_option(help="Episodes for explainers that declare themselves slow."),
    ] = None,
    slow_timesteps: Annotated[
        int | None,
        how_much_option(help="Timesteps per episode for explainers that declare themselves slow."),
    ] = None,
    behaviour_episodes: Annotated[
        int | None,
        how_much_option(
            help="Episodes that the team also plays on the explanation; by default all, or none for "
            "explainers that declare themselves slow."
        ),
    ] = None,
    no_behaviour: Annotated[
        list[str],
        how_much_option(
            metavar="NAME", help="Explainer without episodes played on its masks, or 'all'. Repeatable."
        ),
    ] = [],  # noqa: B006
    max_cycles: MaxCycles = None,
    seed: Seed = 0,
    trust_code: TrustCode = False,
    jobs: Jobs = None,
    backend: Backend = "loky",
    address: Address = None,
    device: Device = "cpu",
    parallel_episodes: Parallel = 50,
    cache: CacheFolder = DEFAULT_FOLDER,
    resume: Resume = True,
    isolate: Isolate = True,
    answer_seconds: AnswerSeconds = UNLIMITED.answer_seconds,
    submitter: Submitter = None,
    out: Annotated[Path, where_option(help="Folder for entries/ and the page.")] = Path("results"),
    suite: Annotated[
        Literal["tasks", "planted"],
        what_option(
            help="`planted`: policies whose relevant messages are known by construction, instead of the "
            "tasks; uses --explainer, --seed, --out, --isolate and --answer-seconds only."
        ),
    ] = "tasks",
) -> None:
    """Score explainers on policies; write one entry per pair and rebuild the leaderboard.

    With --slow-episodes or --slow-timesteps, slow explainers are scored on fewer states. The others are
    scored on these states as well as on all, so that they can be compared. Finished pieces are kept in
    --cache: a run that was stopped continues there. A failure does not stop the rest. Exit code 1: something
    failed.
    """
    from dataclasses import replace

    from xmarl_bench.counted import counted
    from xmarl_bench.entry.file import read_entries, remove_unused, write_entry
    from xmarl_bench.origin.references import is_reference
    from xmarl_bench.parallel.workers import Workers
    from xmarl_bench.records.files import locked, remove_leftovers
    from xmarl_bench.rollout.cell import Sampling, check_parallel
    from xmarl_bench.scoring.arguments import check_among, check_behaviour_episodes
    from xmarl_bench.scoring.cache import Cache, Memory
    from xmarl_bench.scoring.selection import choose_policies, explainers_meant, select_explainers

    names = explainers_meant(explainer)
    limits = replace(UNLIMITED, answer_seconds=answer_seconds) if isolate else None
    if suite == "planted":
        from xmarl_bench.cli import tables

        Sampling(seed=seed)  # refuses what is out of range
        explainers, not_loaded = select_explainers(names, limits)
        tables.exit_for_failures([*not_loaded, *_score_planted(explainers, seed, out)], len(names))
        return
    workers = Workers(jobs, backend, address)
    sampling = Sampling(episodes=episodes, timesteps=timesteps, max_cycles=max_cycles, seed=seed)
    slow = replace(
        sampling,
        episodes=episodes if slow_episodes is None else min(episodes, slow_episodes),
        timesteps=min((t for t in (timesteps, slow_timesteps) if t is not None), default=None),
    )
    check_parallel(parallel_episodes)
    check_behaviour_episodes(behaviour_episodes)
    if not any(map(is_reference, names)):  # code says its name when it runs
        check_among(no_behaviour, names)
    chosen, not_opened = choose_policies(policy, task, agents, team, trust_code=trust_code, limits=limits)
    read_entries(out / "entries")  # fails now rather than after the run if the board cannot be built

    # Whatever needs no network was checked above: these import torch, which takes seconds.
    with without_collector():
        from xmarl_bench.board import build_board
        from xmarl_bench.cli import tables
        from xmarl_bench.cli.score_table import print_scores
        from xmarl_bench.explain.explainer import on_device
        from xmarl_bench.scoring.request import plan
        from xmarl_bench.scoring.score import Failed, score_requests

    found, not_loaded = select_explainers(names, limits)
    explainers = [on_device(each, device) for each in found]
    requests = plan(
        [each.open() for each in chosen],
        explainers,
        sampling,
        slow,
        behaviour_episodes=behaviour_episodes,
        no_behaviour=no_behaviour,
    )
    entries: list[Entry] = []
    failed: list[Failed] = []
    with locked(out):
        remove_leftovers(out)
        outcomes = score_requests(
            requests,
            workers=workers,
            parallel_episodes=parallel_episodes,
            progress=True,
            submitter=submitter,
            cache=Cache(cache) if isolate else Memory(),
            fresh=not resume,
            out=out,
            in_order=False,
        )
        try:
            with tables.says_if_stopped(
                lambda: f"{len(entries)} of {counted(len(requests), 'entry')} in {out / 'entries'}, ",
                cache if isolate else None,
            ):
                for outcome in outcomes:
                    if isinstance(outcome, Failed):
                        failed.append(outcome)
                        continue
                    path = write_entry(out / "entries", outcome)
                    entries.append(outcome)
                    if not sys.stderr.isatty():  # a log has no progress bar
                        print(f"{len(entries)} of {len(requests)}: {path}", flush=True)
        finally:
            if entries:  # also after an interruption
                remove_unused(out / "entries")
                board = build_board(out)
    if entries:
        print_scores(entries, explainers)
        where = f"{out / 'entries'}, leaderboard in {board} and {out / 'index.html'}"
        print(f"{counted(len(entries), 'entry')} in {where}.")
    absent = [*not_opened, *not_loaded]
    tables.exit_for_failures([*absent, *failed], len(absent) + len(requests))


def _score_planted(explainers: Sequence[Explainer], seed: int, out: Path) -> list[InputError]:
    """Scores and prints; the errors of the explainers that failed somewhere, one each."""
    from xmarl_bench.cli.fitted_table import print_table
    from xmarl_bench.counted import first_of
    from xmarl_bench.meta.planted_suite import (
        PlantedScore,
        agreement,
        by_family,
        means_of,
        record,
        score_planted,
    )
    from xmarl_bench.planted.families import SIZES
    from xmarl_bench.records.files import write_json

    found = score_planted(explainers, seed=seed)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "planted.json", record(found, seed))
    print_table(
        [
            {
                "explainer": name,
                "AUROC": f"{means['auroc']:.2f}",
                "AP": f"{means['precision']:.2f}",
                "fidelity": f"{means['fidelity']:.2f}",
                **{family: f"{mean:.2f}" for family, mean in by_family(found, name, "auroc").items()},
            }
            for name, means in means_of(found).items()
        ]
    )
    tau = agreement(found)
    sizes = ", ".join(map(str, SIZES))
    print(
        f"Planted truth, teams of {sizes}: AUROC, average precision (AP), message fidelity; AUROC by family."
    )
    if tau is not None:
        print(f"Kendall's tau of AUROC and message fidelity over explainers: {tau:.2f}.")
    print(f"All numbers in {out / 'planted.json'}.")
    errors: dict[str, list[PlantedScore]] = {}
    for each in found:
        if each.error is not None:
            errors.setdefault(each.explainer, []).append(each)
    failed = []
    for scores in errors.values():
        graphs = first_of([f"{each.family} of {each.n_agents}" for each in scores], 1)
        failed.append(InputError(f"on {graphs}: {scores[0].error}"))
    return failed
