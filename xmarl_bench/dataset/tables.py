"""The arrays of a dataset: a policy's episodes with its attention and oracle tables, or planted truth.

Tables follow xmarl_bench.explain.oracle and xmarl_bench.explain.absence, with the random numbers that
scoring draws: metrics computed from a dataset are those of an entry with the same seed, up to float32.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from xmarl_bench.dataset.card import Card
from xmarl_bench.errors import InputError
from xmarl_bench.explain.absence import message_table
from xmarl_bench.explain.oracle import change_table, why_not_enumerated
from xmarl_bench.metrics import others_table
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.origin.installed import harness_version
from xmarl_bench.planted.families import planted
from xmarl_bench.policy import GraphPolicy, Policy, existing_edges
from xmarl_bench.policy.architecture import CodeArchitecture
from xmarl_bench.policy.bundle import packed
from xmarl_bench.policy.card import PolicyCard
from xmarl_bench.reproducible import derived_seed, episode_seeds, one_thread
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import Rollout
from xmarl_bench.rollout.reference_states import reference_states

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Dataset:
    """The arrays of xmarl_bench.dataset.card.MEANINGS, their card, and the policy that was asked."""

    card: Card
    arrays: Arrays
    bundle: tuple[PolicyCard, bytes] | None = None  # None if the policy is code, or the file was read


def dataset_name(card: PolicyCard, cell: Cell) -> str:
    """The policy's name, with the team's size if it is not that of its training."""
    return card.name if cell.n_agents == card.n_agents else f"{card.name}-n{cell.n_agents}"


def played_dataset(
    policy: Policy,
    card: PolicyCard,
    cell: Cell,
    *,
    episodes: int = 100,
    seed: int = 0,
    max_cycles: int | None = None,
) -> Dataset:
    """Play the first episodes of a `score` run with this seed; keep every timestep."""
    seeds = episode_seeds(seed, episodes)
    policy = copy.deepcopy(policy).eval()
    played = Rollout(policy, cell, tuple(seeds), max_cycles).play()
    with one_thread():
        reference = reference_states(policy, cell, max_cycles)
        parts = [
            _asked(
                policy,
                torch.tensor(each.observations),
                reference,
                np.random.default_rng(derived_seed("states", seed, each.seed)),
            )
            for each in played
        ]
    arrays = _joined(parts)
    if reference is not None:
        arrays["reference"] = reference.numpy()
    arrays["episode"] = np.repeat(np.arange(episodes), [each.makespan for each in played])
    arrays["timestep"] = np.concatenate([np.arange(each.makespan) for each in played])
    arrays["seed"] = np.array(seeds)
    about = Card(
        name=dataset_name(card, cell),
        task=cell.task,
        n_agents=cell.n_agents,
        episodes=episodes,
        seed=seed,
        weights_sha256=card.weights_sha256,
        harness_version=harness_version(),
    )
    code = isinstance(card.architecture, CodeArchitecture)
    fields = card.model_dump(exclude={"architecture", "weights_sha256"})
    return Dataset(about, arrays, None if code else packed(policy, **fields))


def planted_dataset(family: str, n_agents: int, *, n_steps: int = 100, seed: int = 0) -> Dataset:
    """A family of xmarl_bench.planted with its truth. Its states are random, and each is an episode."""
    truth = planted(family, n_agents, n_steps=n_steps, seed=seed)
    rng = np.random.default_rng(derived_seed("planted", seed, family, n_agents))
    with one_thread():
        arrays = _asked(truth.policy, truth.observations, truth.reference, rng)
    arrays |= {
        "reference": truth.reference.numpy(),
        "episode": np.arange(n_steps),
        "timestep": np.zeros(n_steps, dtype=np.int64),
        "relevant": truth.relevant.astype(np.uint8),
        "counted": truth.counted.astype(np.uint8),
    }
    about = Card(
        name=f"planted-{family}-n{n_agents}",
        task="planted",
        n_agents=n_agents,
        episodes=n_steps,
        seed=seed,
        harness_version=harness_version(),
    )
    bundle = packed(truth.policy, name=about.name, task=about.task, n_agents=n_agents, attention_entropy=0.0)
    return Dataset(about, arrays, bundle)


@torch.no_grad()
def _asked(
    policy: Policy, observations: Tensor, reference: Tensor | None, rng: np.random.Generator
) -> Arrays:
    """(S, N, D): what the policy does at these timesteps, and how that changes without messages."""
    arrays: Arrays = {
        "observation": observations.numpy(),
        "action": policy.distribution(observations).action.numpy(),
    }
    with suppress(InputError):  # no layer has attention
        arrays["attention"] = policy.attention(observations).numpy()
    edges = existing_edges(policy, observations)
    if edges is not None:
        arrays["edge"] = edges.astype(np.uint8)
    if why_not_enumerated(policy, observations.shape[1]) is None:
        change = change_table(policy, observations)
        tables = {"change": change, "message_change_zero": others_table(change)}
        if isinstance(policy, GraphPolicy) and reference is not None:
            for absence in Absence:
                if absence is not Absence.ZERO:
                    table = message_table(policy, observations, absence, reference, rng)
                    tables[f"message_change_{absence}"] = table
        arrays |= {name: table.astype(np.float32) for name, table in tables.items()}
    return arrays


def _joined(parts: Sequence[Arrays]) -> Arrays:
    """The arrays of several episodes as one: timesteps are the second axis of tables, else the first."""
    return {
        name: np.concatenate([part[name] for part in parts], axis=1 if "change" in name else 0)
        for name in parts[0]
    }
