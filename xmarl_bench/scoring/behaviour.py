"""Behavioural fidelity: does the explanation suffice to do the task, and does the task fail without it?

The team is rolled out twice from the start of each episode: communicating only along the k highest messages
of each row of the explanation, and only along the others. The explainer is called at every step, on the state
of its own team. Success and reward are compared with those of the full team's episode. Every agent keeps its
own edge, and k is half of the N - 1 others, so that both teams lose about the same number of messages.

Explainers are fast on many states at once, but rounding of matrix products depends on the batch size. So
BLOCK consecutive episodes of a run are always explained and acted together, and the last block is padded:
results depend on (policy, explainer, seed, episode), not on the number of processes.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from xmarl_envs import make_task

from xmarl_bench.entry.schema import BehaviourRow
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.metrics import mask_of_senders, other_senders, top_k_rows
from xmarl_bench.policy import Policy, existing_edges
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.rollout.episodes import Episode, Floats, initial_state, play, with_actions_of
from xmarl_bench.scoring.states import number

BLOCK = 50  # episodes: the protocol's, in one batch
SMALLEST_TEAM = 3  # smaller teams have no two messages to choose between


def why_no_behaviour(n_agents: int) -> str | None:
    """Why a team of this size cannot be rolled out; None if it can."""
    if n_agents < SMALLEST_TEAM:
        return f"needs {SMALLEST_TEAM} agents, so that there are messages to choose between, got {n_agents}"
    return None


def kept_messages(n_agents: int) -> int:
    """k: half of the others, rounded down."""
    return (n_agents - 1) // 2


@dataclass(frozen=True)
class Played:
    rows: list[BehaviourRow]  # by episode
    seconds: float


@dataclass(frozen=True)
class BehaviourBlock:
    """At most BLOCK episodes to play with both teams: a unit of work for a worker."""

    policy: Policy
    explainer: Explainer | None  # None: messages chosen at random, as a baseline
    task: str
    n_agents: int
    seeds: tuple[int, ...]  # of the episodes
    seed: int  # of the run
    max_cycles: int | None

    def run(self) -> Played | InputError:
        """Play the episodes. If the explainer fails, returns (not raises) an error that names it."""
        n, started = len(self.seeds), time.perf_counter()
        try:
            with one_thread():
                episodes = play(
                    with_actions_of(self.policy, make_task(self.task, self.n_agents)),
                    _BlockAct(self),
                    self.seeds + self.seeds,
                    start=initial_state(self.policy, self.n_agents),
                    parallel_episodes=2 * n,
                    max_cycles=self.max_cycles,
                )
        except InputError as error:
            return error
        teams = [_row(*pair) for pair in zip(episodes[:n], episodes[n:], strict=True)]
        return Played(teams, time.perf_counter() - started)


class _BlockAct:
    """Explains and acts for the 2 n teams of a block: n keep the explanation, n keep its complement."""

    def __init__(self, block: BehaviourBlock) -> None:
        self.block = block
        self.policy = copy.deepcopy(block.policy).eval()  # torch aligns the copy's memory; pickle does not
        self.n_steps = 0

    def __call__(self, observation: Floats, slots: Sequence[int]) -> tuple[NDArray[Any], Floats]:
        """(2 n, N, D + H) -> (2 n, N, A), (2 n, N, H)."""
        block, n = self.block, len(self.block.seeds)
        parts = block.seed, block.seeds[0], self.n_steps
        self.n_steps += 1
        # Always 2 * BLOCK teams, also when some have finished: copies of the first one pad the batch.
        filled = observation[[*range(n), *[0] * (BLOCK - n), *range(n, 2 * n), *[n] * (BLOCK - n)]]
        x = torch.tensor(filled)
        noise = np.random.default_rng(derived_seed("behaviour ties", *parts)).random(
            (*x.shape[:2], x.shape[1])
        )
        mask = np.zeros_like(noise)  # all values tie
        if block.explainer is not None:
            seed = derived_seed("behaviour", block.explainer.name, *parts)
            mask = run_explainer(block.explainer, self.policy, x, seed).double().numpy()
        edges = existing_edges(self.policy, x)
        top = top_messages(mask, noise, kept_messages(block.n_agents), edges)
        own = torch.eye(block.n_agents)
        top[BLOCK:] = 1.0 - top[BLOCK:]
        with torch.inference_mode():
            distribution, memory = self.policy.step(x, torch.maximum(top, own))
        played = [*range(n), *range(BLOCK, BLOCK + n)]
        return distribution.choice.numpy()[played], memory.numpy()[played]


def _row(kept: Episode, dropped: Episode) -> BehaviourRow:
    values = {
        "success_on_explanation": kept.success_rate,
        "success_on_complement": dropped.success_rate,
        "reward_on_explanation": kept.reward,
        "reward_on_complement": dropped.reward,
        "no_agent_collision_on_explanation": kept.no_agent_collision,
        "no_agent_collision_on_complement": dropped.no_agent_collision,
        "behavioural_fidelity": kept.success_rate - dropped.success_rate,
    }
    return BehaviourRow.model_validate({name: number(value) for name, value in values.items()})


def top_messages(
    mask: NDArray[np.floating], noise: NDArray[np.float64], k: int, edges: NDArray[np.bool_] | None = None
) -> Tensor:
    """(S, N, N) mask, noise to break ties -> (S, N, N) of zeros and ones: the k highest others of each row.

    edges: (S, N, N), the edges of the graph; a receiver with fewer than k others keeps all of them.
    """
    others = None if edges is None else other_senders(edges)
    rows = top_k_rows(other_senders(mask), other_senders(noise), others)[k - 1]
    return torch.from_numpy(mask_of_senders(rows, ~np.eye(mask.shape[-1], dtype=bool)))
