"""`xmarl-bench evaluate`."""

from __future__ import annotations

from typing import Annotated

import typer

from xmarl_bench.cli.options import (
    Address,
    Agents,
    AsJson,
    Backend,
    Episodes,
    Jobs,
    MaxCycles,
    Parallel,
    Policies,
    Seed,
    Tasks,
    Teams,
    TrustCode,
)


def evaluate(
    task: Tasks = ["all"],  # noqa: B006
    agents: Agents = ["all"],  # noqa: B006
    team: Teams = [],  # noqa: B006
    policy: Policies = ["all"],  # noqa: B006
    episodes: Episodes = 50,
    max_cycles: MaxCycles = None,
    seed: Seed = 0,
    trust_code: TrustCode = False,
    jobs: Jobs = None,
    backend: Backend = "loky",
    address: Address = None,
    parallel_episodes: Parallel = 50,
    as_json: AsJson = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the table of the README.")] = False,
) -> None:
    """Measure how well policies do their task, with messages between agents and without."""
    from xmarl_bench.cli import tables
    from xmarl_bench.cli.fitted_table import print_table
    from xmarl_bench.cli.score_table import performance_rows
    from xmarl_bench.isolation.limits import UNLIMITED
    from xmarl_bench.parallel.workers import Workers
    from xmarl_bench.rollout.cell import Sampling
    from xmarl_bench.rollout.evaluation import evaluate as run
    from xmarl_bench.scoring.selection import select_policies

    selected = select_policies(policy, task, agents, team, trust_code=trust_code, limits=UNLIMITED)
    pairs = [(network, card, cell) for network, card, cells in selected for cell in cells]
    performances = run(
        [(network, cell) for network, _, cell in pairs],
        Sampling(episodes=episodes, max_cycles=max_cycles, seed=seed),
        workers=Workers(jobs, backend, address),
        parallel_episodes=parallel_episodes,
        progress=True,
    )
    cards = [card for _, card, _ in pairs]
    if as_json:
        tables.print_json(
            [{"policy": card.name, **each.record()} for card, each in zip(cards, performances, strict=True)]
        )
        return
    rows = performance_rows(cards, performances)
    if markdown:
        print(tables.markdown(rows))
    else:
        print_table(rows, keep=("success",))
