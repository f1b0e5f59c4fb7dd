"""The unit of work of scoring: one episode, explained and measured in one batch.

Matrix products round differently in batches of another size and in memory of another alignment, so an
episode is always one batch of its own, in tensors that torch allocates: its row depends on nothing but
(policy, explainer, seed, episode, timesteps).
"""

from __future__ import annotations

import copy
import math
import time
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from xmarl_bench.entry import EpisodeRow
from xmarl_bench.explainer import Explainer, run_explainer
from xmarl_bench.metrics import (
    fidelity,
    graph_explanation_unfaithfulness,
    kl_divergence,
    mask_mass,
    prediction_change,
)
from xmarl_bench.policy import ActionDistribution, GraphPolicy
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.rollout import Episode


@dataclass(frozen=True)
class Unit:
    """One episode to explain and measure."""

    policy: GraphPolicy
    explainer: Explainer
    episode: Episode
    seed: int  # of the run
    timesteps: int | None  # at most so many; None is all
    walls: bool  # the task has walls to collide with


@dataclass(frozen=True)
class Measured:
    row: EpisodeRow
    explain_seconds: float


def measure(unit: Unit) -> Measured:
    """Explain the chosen timesteps of one episode and compute its metrics."""
    episode, explainer = unit.episode, unit.explainer
    # A copy is laid out as torch lays it out, also where the policy came through a pickle.
    policy = copy.deepcopy(unit.policy).eval()
    chosen = spaced_timesteps(len(episode.observations), unit.timesteps)
    with one_thread():
        observations = torch.tensor(episode.observations[chosen])
        seed = derived_seed("explainer", unit.seed, explainer.name, episode.seed)
        started = time.perf_counter()
        mask = run_explainer(explainer, policy, observations, seed)
        explain_seconds = time.perf_counter() - started
        metrics = explanation_metrics(policy, observations, mask)
    row = EpisodeRow(
        seed=episode.seed,
        length=len(episode.observations),
        timesteps=len(chosen),
        **metrics,
        reward=_number(episode.reward),
        success_rate=_number(episode.success_rate),
        no_agent_collision=_number(episode.no_agent_collision),
        no_object_collision=_number(episode.no_object_collision) if unit.walls else None,
        makespan=_number(episode.makespan),
    )
    return Measured(row, explain_seconds)


@torch.inference_mode()
def explanation_metrics(
    policy: GraphPolicy, observations: torch.Tensor, mask: torch.Tensor
) -> dict[str, float | None]:
    """Metrics of masks (S, N, N) on observations (S, N, D), averaged over the S timesteps of an episode.

    A timestep whose metric is not a number makes the episode's None.
    """
    prepared = policy.prepare(observations)
    full = policy.decode(prepared)
    kept = policy.decode(prepared, mask)
    dropped = policy.decode(prepared, 1.0 - mask)
    alone = policy.decode(prepared, torch.eye(mask.shape[-1]).expand_as(mask))
    fid = fidelity(_action(full), _action(kept), _action(dropped))
    kl = kl_divergence(full.loc.numpy(), full.scale.numpy(), kept.loc.numpy(), kept.scale.numpy())
    return {
        "fid_plus": _number(fid.plus.mean()),
        "fid_minus": _number(fid.minus.mean()),
        "fid_delta": _number(fid.delta.mean()),
        "gef": _number(graph_explanation_unfaithfulness(kl).mean()),
        "median_kl": _number(np.median(kl)),
        "mask_mass": _number(mask_mass(mask.numpy()).mean()),
        "communication_dependence": _number(prediction_change(_action(full), _action(alone)).mean()),
    }


def spaced_timesteps(length: int, timesteps: int | None) -> NDArray[np.int64]:
    """Indices of at most `timesteps` evenly spaced steps of `length`: the middles of equal stretches."""
    if timesteps is None or timesteps >= length:
        return np.arange(length)
    return np.asarray((2 * np.arange(timesteps) + 1) * length // (2 * timesteps))


def _action(distribution: ActionDistribution) -> NDArray[np.float32]:
    return np.asarray(distribution.action.numpy())


def _number(value: float) -> float | None:
    """JSON has no NaN: what is not a finite number is None, and is counted as `n_nan` further on."""
    return float(value) if math.isfinite(value) else None
