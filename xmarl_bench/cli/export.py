"""`xmarl-bench export`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from xmarl_bench.cli.options import Agents, Jobs, MaxCycles, Policies, Seed, Tasks, Teams, TrustCode


def export(
    task: Tasks = ["all"],  # noqa: B006
    agents: Agents = ["all"],  # noqa: B006
    team: Teams = [],  # noqa: B006
    policy: Policies = ["default"],  # noqa: B006
    suite: Annotated[
        Literal["tasks", "planted"],
        typer.Option(help="`planted`: policies whose relevant messages are known, with the truth."),
    ] = "tasks",
    episodes: Annotated[int, typer.Option(help="Episodes per policy; of `planted`, states.")] = 100,
    max_cycles: MaxCycles = None,
    seed: Seed = 0,
    trust_code: TrustCode = False,
    jobs: Jobs = None,
    out: Annotated[Path, typer.Option(help="Folder of the files.")] = Path("dataset"),
) -> None:
    """Write states, attention and oracle tables as files, to develop explainers without simulating.

    A safetensors file and its card for each policy, and the policy itself. Interrupted, it leaves
    only complete files.
    """
    from xmarl_bench.dataset import dataset_name, planted_dataset, played_dataset, written
    from xmarl_bench.errors import InputError
    from xmarl_bench.parallel.fan_out import in_order
    from xmarl_bench.parallel.workers import Workers
    from xmarl_bench.planted.families import teams
    from xmarl_bench.records.files import check_writable
    from xmarl_bench.rollout.cell import Sampling
    from xmarl_bench.scoring.selection import select_policies

    check_writable(out)
    Sampling(episodes=episodes, max_cycles=max_cycles, seed=seed)  # refuses what is out of range
    if suite == "planted":
        units = [
            partial(planted_dataset, family, size, n_steps=episodes, seed=seed) for family, size in teams()
        ]
    else:
        played = [
            (network, card, cell)
            for network, card, cells in select_policies(policy, task, agents, team, trust_code=trust_code)
            for cell in cells
        ]
        names = [dataset_name(card, cell) for _, card, cell in played]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two datasets would be {name}: export one of them into another folder.")
        units = [
            partial(played_dataset, *each, episodes=episodes, seed=seed, max_cycles=max_cycles)
            for each in played
        ]
    for path in in_order(partial(written, out), units, workers=Workers(jobs), progress="export"):
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
