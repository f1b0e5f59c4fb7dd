"""Prints what the draws of `resample` cost an explainer that cannot know them: a table of docs/metrics.md.

    .venv/bin/python docs/measure_draws.py

Explainers do not see which reference states are drawn, the oracle does. So the best that an explainer can do
is the best set of messages over all reference states. The table has its budgeted fidelity under `resample` as
it is scored, with DRAWS draws, and attention's with these draws and over all reference states. On TIMESTEPS
timesteps of each of the first EPISODES scoring episodes of the default policies, mean over a task's policies.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from xmarl_bench.explain.absence import Removal, message_rows, message_table
from xmarl_bench.metrics import budgeted_fidelity, choices, other_senders
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.policy import GraphPolicy, load_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.default_policies import default_policies
from xmarl_bench.reproducible import derived_seed, episode_seeds
from xmarl_bench.rollout.cell import Cell, spaced_timesteps
from xmarl_bench.rollout.episodes import Episode, Rollout
from xmarl_bench.rollout.reference_states import fit_states
from xmarl_bench.scoring.enumerated import Table

EPISODES: Final = 5
TIMESTEPS: Final = 20
Floats = NDArray[np.float64]


def best_without_knowing(drawn: Floats, expected: Floats) -> Floats:
    """(R, S, N) FidDelta by the draws and over all states -> (M - 1,): of the sets best over all states."""
    size = np.bitwise_count(np.arange(len(drawn)))
    found = []
    for k in range(1, int(size.max())):
        rows = size == k
        best = expected[rows].argmax(axis=0)[None]
        found.append(np.take_along_axis(drawn[rows], best, axis=0).mean())
    return np.array(found)


def of_episode(policy: GraphPolicy, reference: torch.Tensor, episode: Episode) -> list[float]:
    """The best without knowing, attention by the draws, attention over all reference states."""
    chosen = spaced_timesteps(episode.makespan, TIMESTEPS)
    observations = torch.tensor(episode.observations[chosen])
    n_steps, n_agents, _ = observations.shape
    masks = message_rows(n_agents)[:, None].expand(-1, n_steps, -1, -1)
    rng = np.random.default_rng(derived_seed("draws", episode.seed))
    drawn = Table.of(message_table(policy, observations, Absence.RESAMPLE, reference, rng), None)
    with torch.no_grad():
        everything = tuple(each.expand(n_steps, -1, -1) for each in policy.prepare(reference).message)
        share = choices(other_senders(policy.attention(observations).numpy()))
    expected = Table.of(Removal(policy, observations, Absence.RESAMPLE, everything).change(masks), None)
    blind = best_without_knowing(drawn.delta, expected.delta)
    scored = [table.score(share).budgeted for table in (drawn, expected)]
    return [budgeted_fidelity(blind, drawn.random, drawn.oracle), *scored]


def of_policy(folder: Path) -> tuple[str, list[float]]:
    """The task, and means over episodes."""
    policy, card = load_policy(folder)
    assert isinstance(policy, GraphPolicy)
    reference = fit_states(policy, Cell(card.task, card.n_agents))
    seeds = tuple(episode_seeds(0, EPISODES))
    episodes = Rollout(policy, Cell(card.task, card.n_agents), seeds, None).play()
    values = np.nanmean([of_episode(policy, reference, each) for each in episodes], axis=0)
    return card.task, values.tolist()


if __name__ == "__main__":
    torch.set_num_threads(1)
    by_task = defaultdict(list)
    folders = find_policies()
    for card in default_policies(map(load_card, folders.values())):
        task, values = of_policy(folders[card.name])
        print(f"{card.name}: {', '.join(f'{value:.3f}' for value in values)}", flush=True)
        by_task[task].append(values)
    print("| task | best without knowing the draws | attention, by the draws | attention, over all states |")
    print("|---|---|---|---|")
    for task, of_task in sorted(by_task.items()):
        print(f"| {task} | {' | '.join(f'{value:.2f}' for value in np.mean(of_task, axis=0))} |")
