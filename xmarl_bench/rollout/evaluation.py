"""How well policies do their task, with messages between agents and without. Involves no explainer."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from math import isnan
from typing import Any

import numpy as np
import torch

from xmarl_bench.metrics import attention_entropy
from xmarl_bench.metrics.statistics import over_units
from xmarl_bench.metrics.table import GAINS
from xmarl_bench.parallel.fan_out import in_order
from xmarl_bench.parallel.workers import ONE_PROCESS, Workers
from xmarl_bench.policy import Policy
from xmarl_bench.policy.interface import NoAttentionError
from xmarl_bench.reproducible import one_thread, torch_defaults
from xmarl_bench.rollout.cell import BLOCK, Cell, Sampling, check_parallel
from xmarl_bench.rollout.episodes import Episode, Rollout, mean_metrics


@dataclass(frozen=True)
class Performance:
    """Means of the task metrics over episodes; None for a metric that the task does not have."""

    task: str
    n_agents: int
    episodes: int
    seed: int
    max_cycles: int
    with_messages: dict[str, float | None]
    without_messages: dict[str, float | None]  # F(identity): every agent hears itself only
    # nats, over the episodes with messages; log N: uniform; None: the policy has no attention that sums to 1
    attention_entropy: float | None
    # Success and reward with messages minus without, paired by episode: {metric: {value, low, high}}, 95 %.
    # Empty in older cards.
    messages_gain: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def messages_help(self) -> bool | None:
        """Whether success or reward is higher with messages, by an interval that excludes 0."""
        return any(gain["low"] > 0.0 for gain in self.messages_gain.values()) if self.messages_gain else None

    def record(self) -> dict[str, Any]:
        """As a policy card holds it, under `performance`."""
        return asdict(self)


def evaluate_policy(policy: Policy, task: str, n_agents: int, *, episodes: int = 50) -> dict[str, Any]:
    """One policy's `Performance` as its card records it."""
    return evaluate([(policy, Cell(task, n_agents))], Sampling(episodes=episodes))[0].record()


@torch_defaults()
def evaluate(
    policies: Sequence[tuple[Policy, Cell]],
    sampling: Sampling,
    *,
    workers: Workers = ONE_PROCESS,
    parallel_episodes: int = 50,
    progress: bool = False,
) -> list[Performance]:
    """Roll out each policy on the sampling's episodes twice: as it is, and with all messages removed.

    Scoring plays the same episodes with the same seed. `sampling.timesteps` is ignored.
    """
    check_parallel(parallel_episodes)
    seeds, max_cycles = tuple(sampling.seeds), sampling.max_cycles
    width = min(parallel_episodes, BLOCK)
    units = [
        Rollout(policy, cell, seeds[first : first + width], max_cycles, messages=messages)
        for policy, cell in policies
        for messages in (True, False)
        for first in range(0, len(seeds), width)
    ]
    played = in_order(Rollout.play, units, workers=workers, progress="evaluate" if progress else None)
    every = iter([episode for part in played for episode in part])
    episodes = [[next(every) for _ in seeds] for _ in range(2 * len(policies))]
    performances = []
    for (policy, cell), heard, unheard in zip(policies, episodes[::2], episodes[1::2], strict=True):
        task = cell.make()
        performances.append(
            Performance(
                task=cell.task,
                n_agents=cell.n_agents,
                episodes=sampling.episodes,
                seed=sampling.seed,
                max_cycles=sampling.max_cycles or task.default_max_cycles,
                with_messages=mean_metrics(task, heard),
                without_messages=mean_metrics(task, unheard),
                messages_gain={
                    name: gain for name in GAINS.values() if (gain := _gain(name, heard, unheard)) is not None
                },
                attention_entropy=_attention_entropy(policy, heard),
            )
        )
    return performances


def _gain(name: str, heard: Sequence[Episode], unheard: Sequence[Episode]) -> dict[str, float] | None:
    """The gain of a metric with its interval; None if fewer than two episodes tell the metric."""
    a, b = ([getattr(episode, name) for episode in episodes] for episodes in (heard, unheard))
    gain = over_units([a], [b])
    if gain.value is None or gain.interval is None:
        return None
    low, high = gain.interval
    return {"value": gain.value, "low": low, "high": high}


def _attention_entropy(policy: Policy, episodes: Sequence[Episode]) -> float | None:
    """Mean over timesteps within an episode, then over episodes; None without attention that sums to 1."""
    policy = copy.deepcopy(policy)
    with one_thread(), torch.inference_mode():
        try:
            attention = [policy.attention(torch.tensor(episode.observations)) for episode in episodes]
        except NoAttentionError:
            return None
    means = [float(attention_entropy(alpha.numpy()).mean()) for alpha in attention]
    told = [mean for mean in means if not isnan(mean)]
    return float(np.mean(told)) if told else None
