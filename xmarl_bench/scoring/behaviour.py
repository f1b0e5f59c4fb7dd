"""Behavioural fidelity: does the explanation suffice to do the task, and does the task fail without it?

The team is rolled out twice from the start of each episode: communicating only along the k highest messages
of each row of the explanation, and only along the others. The explainer is called at every step, on the state
of its own team. Success and reward are compared with those of the full team's episode. Every agent keeps its
own edge, and k is half of the N - 1 others, so that both teams lose about the same number of messages.

The absence model says what a team hears in place of the other messages (xmarl_bench.explain.absence). Zero is
played in blocks of BLOCK episodes. The other models share a block of the first ABSENCE_EPISODES.

Explainers are fast on many states at once, but rounding of matrix products depends on the batch size. So the
consecutive episodes of a block are always explained and acted together, and the last block is padded:
results depend on (policy, explainer, seed, episode), not on the number of processes.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.entry.metric_records import BehaviourRow
from xmarl_bench.entry.protocol import ABSENCE_EPISODES
from xmarl_bench.errors import InputError
from xmarl_bench.explain.absence import stand_ins, step_under
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.explain.sampled_oracle import ranks
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.metrics.table import OTHER_ABSENCES
from xmarl_bench.policy import ActionDistribution, GraphPolicy, Policy, existing_edges
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import Episode, Floats, initial_state, play
from xmarl_bench.scoring.rankings import number

BLOCK = 50  # episodes: the protocol's, in one batch
SMALLEST_TEAM = 3  # smaller teams have no two messages to choose between


def why_no_behaviour(explainer: Explainer, n_agents: int) -> str | None:
    """Why a team of this size cannot be rolled out on its explanations; None if it can."""
    if n_agents < SMALLEST_TEAM:
        return f"needs {SMALLEST_TEAM} agents, so that there are messages to choose between, got {n_agents}"
    if explainer.simulates:
        return "the explainer plays on in recorded episodes, and these are not recorded yet"
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
    """Episodes to play with both teams: a unit of work for a worker.

    At most BLOCK of them under zero, or ABSENCE_EPISODES under the other absence models.
    """

    policy: Policy
    explainer: Explainer | None  # None: messages chosen at random, as a baseline
    cell: Cell
    seeds: tuple[int, ...]  # of the episodes
    seed: int  # of the run
    max_cycles: int | None
    reference: Tensor | None = None  # (Q, N, D) states, to play the other models with; None: play zero

    @property
    def absences(self) -> tuple[Absence, ...]:
        return (Absence.ZERO,) if self.reference is None else OTHER_ABSENCES

    @property
    def size(self) -> int:
        """Episodes of a full block."""
        return BLOCK if self.reference is None else ABSENCE_EPISODES

    def run(self) -> Played | InputError:
        """Play the episodes. If the explainer fails, returns (not raises) an error that names it."""
        n, started = len(self.seeds), time.perf_counter()
        teams = 2 * len(self.absences)  # of an episode
        try:
            with one_thread():
                episodes = play(
                    self.cell.make().with_actions(self.policy.continuous_actions),
                    BlockAct(self),
                    self.seeds * teams,
                    start=initial_state(self.policy, self.cell.n_agents),
                    parallel_episodes=teams * n,
                    max_cycles=self.max_cycles,
                )
        except InputError as error:
            return error
        rows = [_row(self.absences, episodes[k::n]) for k in range(n)]
        return Played(rows, time.perf_counter() - started)


class BlockAct:
    """Explains and acts for the teams of a block of n episodes.

    For each absence model, n teams keep the explanation, then n keep its complement.
    """

    def __init__(self, block: BehaviourBlock) -> None:
        self.block = block
        self.policy = copy.deepcopy(block.policy).eval()  # torch aligns the copy's memory; pickle does not
        self.n_steps = 0
        self.messages: Tensor | None = None  # (Q, N, W) of the reference states
        if isinstance(self.policy, GraphPolicy) and block.reference is not None:
            with torch.inference_mode():
                self.messages = self.policy.prepare(block.reference).message

    def __call__(self, observation: Floats, slots: Sequence[int]) -> tuple[NDArray[Any], Floats]:
        """(T, N, D + H) -> (T, N, A), (T, N, H) for the T teams of all models."""
        block, n, size = self.block, len(self.block.seeds), self.block.size
        parts = block.seed, block.seeds[0], self.n_steps
        self.n_steps += 1
        # Always the teams of a full block, also when some have finished: copies of the first one pad it.
        firsts = range(0, len(observation), n)
        filled = [k for first in firsts for k in (*range(first, first + n), *[first] * (size - n))]
        x = torch.tensor(observation[filled])
        noise = np.random.default_rng(derived_seed("behaviour ties", *parts)).random(
            (*x.shape[:2], x.shape[1])
        )
        mask = np.zeros_like(noise)  # all values tie
        if block.explainer is not None:
            seed = derived_seed("behaviour", block.explainer.name, *parts)
            mask = run_explainer(block.explainer, self.policy, x, seed).double().numpy()
        edges = existing_edges(self.policy, x)
        top = top_messages(mask, noise, kept_messages(block.cell.n_agents), edges)
        own = torch.eye(block.cell.n_agents)
        for complement in range(size, len(top), 2 * size):
            top[complement : complement + size] = 1.0 - top[complement : complement + size]
        heard = torch.maximum(top, own)
        rng = np.random.default_rng(derived_seed("behaviour draws", *parts))
        actions, memories = [], []
        for k, absence in enumerate(block.absences):
            teams = slice(2 * size * k, 2 * size * (k + 1))
            with torch.inference_mode():
                distribution, memory = self._step(absence, x[teams], heard[teams], rng)
            actions.append(distribution.choice.numpy())
            memories.append(memory.numpy())
        played = [k for first in range(0, len(x), size) for k in range(first, first + n)]
        return np.concatenate(actions)[played], np.concatenate(memories)[played]

    def _step(
        self, absence: Absence, x: Tensor, mask: Tensor, rng: np.random.Generator
    ) -> tuple[ActionDistribution, Tensor]:
        if absence is Absence.ZERO:
            return self.policy.step(x, mask)
        assert isinstance(self.policy, GraphPolicy)
        assert self.messages is not None
        (stand_in,) = stand_ins(absence, self.messages, (1, len(x)), rng)
        return step_under(self.policy, self.policy.prepare(x), mask, absence, stand_in)


def _row(absences: Sequence[Absence], episodes: Sequence[Episode]) -> BehaviourRow:
    """Of one episode's teams: for each absence model the one on the explanation, then on the complement."""
    values = dict.fromkeys(BehaviourRow.model_fields, math.nan)
    for absence, kept, dropped in zip(absences, episodes[::2], episodes[1::2], strict=True):
        prefix = "" if absence is Absence.ZERO else f"{absence}_"
        measured = {f"{prefix}{name}": value for name, value in _values(kept, dropped).items()}
        values |= {name: value for name, value in measured.items() if name in values}
    return BehaviourRow.model_validate({name: number(value) for name, value in values.items()})


def _values(kept: Episode, dropped: Episode) -> dict[str, float]:
    return {
        "success_on_explanation": kept.success_rate,
        "success_on_complement": dropped.success_rate,
        "reward_on_explanation": kept.reward,
        "reward_on_complement": dropped.reward,
        "no_agent_collision_on_explanation": kept.no_agent_collision,
        "no_agent_collision_on_complement": dropped.no_agent_collision,
        "behavioural_fidelity": kept.success_rate - dropped.success_rate,
    }


def top_messages(
    mask: NDArray[np.floating], noise: NDArray[np.float64], k: int, edges: NDArray[np.bool_] | None = None
) -> Tensor:
    """(S, N, N) mask, noise to break ties -> (S, N, N) of zeros and ones: the k highest others of each row.

    edges: (S, N, N), the edges of the graph; a receiver with fewer than k others keeps all of them.
    """
    there = np.ones(mask.shape, dtype=np.bool_) if edges is None else edges
    senders = there & ~np.eye(mask.shape[-1], dtype=np.bool_)
    top = (ranks(mask.astype(np.float64), noise[None], senders)[0] < k) & senders
    return torch.from_numpy(top.astype(np.float32))
