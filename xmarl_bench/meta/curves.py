"""Values of every metric for a right ranking that gets worse in known steps.

On planted policies, the right ranking is the truth. On trained ones, it is that of Shapley values under one
absence model, for each of the four in turn. Metrics under the same model are then not used: message fidelity
is the mean over the other three (xmarl_bench.meta.right_ranking).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor
from xmarl_envs import make_task

from xmarl_bench.meta.degradation import NOISE, Form, degraded, follows, in_form
from xmarl_bench.meta.right_ranking import ranking_mask, shapley_values, true_mask
from xmarl_bench.metrics import over_absences
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.metrics.table import UNDER_ABSENCES, Direction, Group, by_name, metrics_of
from xmarl_bench.planted.families import SIZES, planted, teams
from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.reproducible import derived_seed, episode_seeds, one_thread
from xmarl_bench.rollout.cell import Cell, spaced_timesteps
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.rollout.reference_states import reference_states
from xmarl_bench.scoring.states import States

# Metrics of a mask for which one end is better.
METRICS: Final = tuple(
    each.name for each in metrics_of(Group.EXPLANATION) if each.direction is not Direction.NONE
)
OVER_ABSENCES: Final = ("message_fidelity", "smallest_message_fidelity")
MODEL_OF: Final = dict(zip(UNDER_ABSENCES, Absence, strict=True))  # all others are under zero
Row = dict[str, float]


@dataclass(frozen=True)
class Curve:
    """A metric at every step of NOISE on one policy, mean over its episodes."""

    policy: str
    form: Form
    right: Absence | None  # absence model of the Shapley values of the right ranking; None: planted truth
    metric: str
    values: tuple[float, ...]

    @property
    def follows(self) -> float:
        """1 if the metric falls at every step, see `degradation.follows`."""
        return follows(self.values, NOISE, higher_is_better=is_higher_better(self.metric))


@dataclass(frozen=True)
class Followed:
    """How well a metric follows the steps."""

    within: float  # Spearman's correlation over the steps of a policy, mean over policies
    smallest: float  # the smallest of them
    over: float  # over all steps of all policies together: can its values be compared between policies?


def is_higher_better(metric: str) -> bool:
    return by_name()[metric].direction is Direction.HIGHER


def planted_curves(*, sizes: Sequence[int] = SIZES, n_steps: int = 50, seed: int = 0) -> Iterator[Curve]:
    """Curves of every family and team size."""
    for family, n_agents in teams(sizes):
        with one_thread():
            truth = planted(family, n_agents, n_steps=n_steps, seed=seed)
            rng = np.random.default_rng(derived_seed("meta", seed, family, n_agents))
            states = States.of(truth.policy, truth.observations, rng, truth.reference)
            mask = true_mask(truth)
            for form in Form:
                rows = _steps(states, mask, form, rng)
                for metric in METRICS:
                    values = tuple(row[metric] for row in rows)
                    yield Curve(f"{family}, {n_agents}", form, None, metric, values)


def trained_curves(
    policy: Policy, card: PolicyCard, *, episodes: int = 10, timesteps: int = 20, seed: int = 0
) -> Iterator[Curve]:
    """Curves of one trained policy, on states of its scoring episodes."""
    measured: dict[tuple[Form, Absence, str], list[list[float]]] = {}
    with one_thread():
        for states, rng in states_of(policy, card, episodes=episodes, timesteps=timesteps, seed=seed):
            for right, ranking in states.tables.items():
                mask = ranking_mask(shapley_values(ranking.delta))
                for form in Form:
                    rows = _steps(states, mask, form, rng)
                    for metric in METRICS:
                        if MODEL_OF.get(metric, Absence.ZERO) is right and metric not in OVER_ABSENCES:
                            continue
                        values = [_without(row, right, metric) for row in rows]
                        measured.setdefault((form, right, metric), []).append(values)
    for (form, right, metric), each in measured.items():
        yield Curve(card.name, form, right, metric, tuple(_mean_of_numbers(each)))


def _mean_of_numbers(rows: Sequence[Sequence[float]]) -> list[float]:
    """Of each column; NaN where it holds no number."""
    values = np.asarray(rows, dtype=np.float64)
    told = ~np.isnan(values)
    total, n = values.sum(axis=0, where=told), told.sum(axis=0)
    return np.divide(total, n, out=np.full(total.shape, np.nan), where=n > 0).tolist()  # type: ignore[no-any-return]


def states_of(
    policy: Policy, card: PolicyCard, *, episodes: int, timesteps: int | None, seed: int
) -> Iterator[tuple[States, np.random.Generator]]:
    """The states of each of the first scoring episodes, with a random generator."""
    reference = reference_states(policy, Cell(card.task, card.n_agents))
    for episode in roll_out(make_task(card.task, card.n_agents), policy, episode_seeds(seed, episodes)):
        rng = np.random.default_rng(derived_seed("meta", seed, card.name, episode.seed))
        chosen = episode.observations[spaced_timesteps(episode.makespan, timesteps)]
        yield States.of(policy, torch.tensor(chosen), rng, reference), rng


def followed(curves: Sequence[Curve], metric: str, form: Form) -> Followed:
    """How well a metric follows the steps, over its curves in one form; NaN if it was not measured."""
    asked = [each for each in curves if (each.metric, each.form) == (metric, form)]
    if not asked:
        return Followed(math.nan, math.nan, math.nan)
    within = [each.follows for each in asked]
    pooled = [value for each in asked for value in each.values]
    over = follows(pooled, NOISE * len(asked), higher_is_better=is_higher_better(metric))
    return Followed(float(np.mean(within)), float(np.min(within)), over)


def _steps(states: States, right: Tensor, form: Form, rng: np.random.Generator) -> list[Row]:
    """All metrics at each step of NOISE; NaN if one has no value."""
    rows = []
    for step, noise in enumerate(NOISE):
        row = states.mask_metrics(in_form(degraded(right, noise, rng), form, step))
        values = np.array([getattr(row, name) for name in METRICS], dtype=np.float64)  # NaN for None
        rows.append(dict(zip(METRICS, values.tolist(), strict=True)))
    return rows


def _without(row: Mapping[str, float], right: Absence, metric: str) -> float:
    """The metric, without the absence model of the right ranking."""
    if metric not in OVER_ABSENCES:
        return row[metric]
    others = [row[name] for name, model in MODEL_OF.items() if model is not right]
    return over_absences(others)[OVER_ABSENCES.index(metric)]
