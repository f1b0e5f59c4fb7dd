"""Prints what a timestep costs by team size: the table of docs/scaling.md.

    .venv/bin/python docs/measure_team_sizes.py

CPU seconds of one thread to explain and measure a timestep by attention, with all controls and the oracle
under every absence model that can be measured, and the memory of the process. States are those of the first
scoring episode of policies trained with five agents, in teams of each size. The policy of two layers is
untrained.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from multiprocessing import get_context
from resource import RUSAGE_SELF, getrusage
from typing import Final

import torch

from xmarl_bench.explain.oracle import oracle_kind
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import Policy, load_policy
from xmarl_bench.policy.architecture import LayeredArchitecture
from xmarl_bench.policy.build import untrained_policy
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.rollout.reference_states import reference_states
from xmarl_bench.scoring.measure import Unit

DEEP: Final = "two layers"
POLICIES: Final = {
    "navigation-n5-residual-lambda0.1-seed0": (5, 8, 10, 11, 16, 32),
    "discovery-n5-residual-lambda0.03-seed0": (5, 8, 10, 11, 16, 32),
    DEEP: (3, 5, 10),
}
TIMESTEPS: Final = {5: 40, 3: 40, 8: 20, 10: 10, 11: 4, 16: 2, 32: 1}
SEED: Final = 10**12  # of the first scoring episode


def two_layers() -> Policy:
    """As wide as the reference policy of discovery."""
    layer = {"conv": "GATv2Conv", "width": 32, "activation": "tanh"}
    architecture = LayeredArchitecture.model_validate(
        {
            "obs_dim": 6,
            "encoder": (64,),
            "encoder_activation": "relu",
            "layers": (layer, layer),
            "decoder": (64, 64),
            "decoder_activation": "relu",
        }
    )
    return untrained_policy(architecture, 0)


def cost(name: str, n_agents: int) -> tuple[str, float, float]:
    """Kind of oracle, CPU seconds per timestep, peak MB of this process."""
    policy, task = two_layers(), "blind_navigation_v0"
    if name != DEEP:
        policy, card = load_policy(find_policies()[name])
        task = card.task
    (episode,) = roll_out(Cell(task, n_agents).make(), policy, [SEED])
    reference = reference_states(policy, Cell(task, n_agents))

    def seconds(timesteps: int) -> float:
        started = time.process_time()
        explainers = (find_explainer("attention"),)
        result = Unit(policy, explainers, episode, 0, timesteps, False, reference).run()
        assert result.shared is not None
        return (time.process_time() - started) / result.shared.timesteps

    seconds(1)  # first calls take longer
    found = seconds(TIMESTEPS[n_agents])
    return oracle_kind(policy, n_agents) or "none", found, getrusage(RUSAGE_SELF).ru_maxrss / 1e3


def rows() -> Iterator[str]:
    """Each in a process of its own, for its memory."""
    yield "| policy | agents | oracle | CPU seconds a timestep | peak MB |"
    yield "|---|---|---|---|---|"
    for name, sizes in POLICIES.items():
        for n_agents in sizes:
            with get_context("spawn").Pool(1) as pool:
                kind, seconds, megabytes = pool.apply(cost, (name, n_agents))
            yield f"| {name} | {n_agents} | {kind} | {seconds:.2g} | {megabytes:.0f} |"


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    torch.set_num_threads(1)
    for row in rows():
        print(row, flush=True)
