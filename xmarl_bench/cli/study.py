"""`xmarl-bench study`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from xmarl_bench.cli.options import (
    Address,
    AnswerSeconds,
    Backend,
    CacheFolder,
    Episodes,
    Isolate,
    Jobs,
    MaxCycles,
    Policies,
    Resume,
    Seed,
    Submitter,
    Timesteps,
)
from xmarl_bench.isolation.limits import UNLIMITED
from xmarl_bench.scoring.cache import DEFAULT_FOLDER


def study(
    name: Annotated[
        Literal["main", "training", "zero-shot"],
        typer.Argument(
            help="main: three tasks, three team sizes; training: checkpoints; zero-shot: larger teams."
        ),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="4 timesteps of 4 episodes: a preview, not a result.")
    ] = False,
    policy: Policies = ["all"],  # noqa: B006
    explainer: Annotated[
        list[str],
        typer.Option("--explainer", help="Further explainer, not compared by the ledgers. Repeatable."),
    ] = [],  # noqa: B006
    episodes: Episodes = 50,
    timesteps: Timesteps = None,
    max_cycles: MaxCycles = None,
    behaviour: Annotated[
        list[str],
        typer.Option(
            help="Explainer whose masks the team also plays on, or 'all'. It is called at every step, which "
            "takes most explainers longer than everything else. Repeatable; none by default."
        ),
    ] = [],  # noqa: B006
    figures: Annotated[bool, typer.Option(help="Draw figures; needs the extra 'plots'.")] = True,
    entries: Annotated[
        Path | None,
        typer.Option(
            help="Judge the entries of this folder, such as leaderboard, with these policies, explainers "
            "and states. Nothing is scored."
        ),
    ] = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    backend: Backend = "loky",
    address: Address = None,
    cache: CacheFolder = DEFAULT_FOLDER,
    resume: Resume = True,
    isolate: Isolate = True,
    answer_seconds: AnswerSeconds = UNLIMITED.answer_seconds,
    submitter: Submitter = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; study/NAME or study/NAME-quick by default.")
    ] = None,
) -> None:
    """Reproduce a study of the paper and judge its statements.

    Finished pieces are kept in --cache and not computed again. A failure does not stop the rest, and is
    missing from the study, as is what --entries lacks. Exit code 1: something failed or is missing.
    """
    from dataclasses import replace

    from xmarl_bench.cli import tables
    from xmarl_bench.counted import counted
    from xmarl_bench.entry.file import folder_of_entries
    from xmarl_bench.errors import InputError
    from xmarl_bench.papers.kailas2025.existing import existing_entries
    from xmarl_bench.papers.kailas2025.figures import check_matplotlib
    from xmarl_bench.papers.kailas2025.output import write_study
    from xmarl_bench.papers.kailas2025.plan import EXPLAINERS, QUICK, STUDIES, plan
    from xmarl_bench.papers.kailas2025.results import StudyData
    from xmarl_bench.papers.kailas2025.samples import Samples
    from xmarl_bench.parallel.workers import Workers
    from xmarl_bench.records.files import locked, remove_leftovers
    from xmarl_bench.rollout.cell import Sampling
    from xmarl_bench.scoring.cache import Cache, Memory
    from xmarl_bench.scoring.score import Failed, score_requests
    from xmarl_bench.scoring.selection import select_explainers

    workers = Workers(jobs, backend, address)
    chosen = STUDIES[name]
    folder = out or Path("study") / (f"{name}-quick" if quick else name)
    if figures:
        check_matplotlib()
    if quick:
        episodes, timesteps = QUICK.episodes, QUICK.timesteps
    sampling = Sampling(episodes=episodes, timesteps=timesteps, max_cycles=max_cycles, seed=seed)
    limits = replace(UNLIMITED, answer_seconds=answer_seconds) if isolate else None
    explainers, not_loaded = select_explainers([*EXPLAINERS, *explainer], limits)
    requests = plan(chosen, policy, explainers, sampling, behaviour)
    Samples.check(request.card for request in requests)
    with locked(folder):
        remove_leftovers(folder)
        if entries is not None:
            outcomes = existing_entries(requests, entries)
        else:
            scored = score_requests(
                requests,
                workers=workers,
                progress=True,
                submitter=submitter,
                cache=Cache(cache) if isolate else Memory(),
                fresh=not resume,
                out=folder,
            )
            with tables.says_if_stopped(lambda: "", cache if isolate else None):
                outcomes = list(tables.log_progress(scored, len(requests)))
        pairs = [
            (request.card, outcome)
            for request, outcome in zip(requests, outcomes, strict=True)
            if not isinstance(outcome, Failed)
        ]
        failed: list[Failed | InputError] = [*not_loaded]
        failed += [each for each in outcomes if isinstance(each, Failed)]
        if not pairs:
            tables.exit_for_failures(failed, len(not_loaded) + len(requests))
        names = tuple(explainer.name for explainer in explainers)
        existing = entries is not None and folder_of_entries(entries.resolve()).parent.name == "leaderboard"
        data = StudyData(chosen, names, pairs, Samples.of(pairs), existing=existing)
        results = write_study(folder, data, figures=figures)
    verdicts = [claim["verdict"] for claim in results["ledger"]]
    by_verdict = ", ".join(f"{verdicts.count(each)} {each}" for each in sorted(set(verdicts)))
    for absent in results["missing"]:
        print(f"missing: {absent}")
    print(f"{counted(len(verdicts), 'statement')} of the paper: {by_verdict}.")
    print(f"{counted(len(pairs), 'entry')}; look at {folder / 'report.html'}.")
    tables.exit_for_failures(failed, len(not_loaded) + len(requests))
