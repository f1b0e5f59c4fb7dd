"""Entries with random numbers instead of measurements, in milliseconds each, for tests of the board."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache

import numpy as np
from xmarl_envs import TASKS

from tests.helpers.policies import small_policy
from xmarl_bench.entry.metric_records import (
    BehaviourRow,
    BudgetRow,
    ControlMetrics,
    EpisodeRow,
    ExplanationRow,
    Metrics,
    Summary,
)
from xmarl_bench.entry.protocol import DEFINITIONS
from xmarl_bench.entry.schema import (
    CellResult,
    Cost,
    Entry,
    ExplainerRecord,
    OracleRecord,
    PolicyRecord,
    Protocol,
    Provenance,
    make_entry,
)
from xmarl_bench.explain.control_names import INVERTED, NEAREST
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.reproducible import derived_seed, episode_seeds

SHARES = (*ExplanationRow.model_fields, *BehaviourRow.model_fields, "seed_stability", "weight_randomisation",
          "attention_entropy", "attention_distance")  # fmt: skip
ARCHITECTURE = small_policy(6).architecture


def made_entry(
    policy: str,
    explainer: str,
    level: float,
    *,
    task: str = "blind_navigation_v0",
    n_agents: int = 3,
    attention_entropy: float = 0.0,
    episodes: int = 50,
    control: bool = False,
    submitter: str | None = None,
    oracle: OracleRecord | None = None,
    trained: int | None = None,
    training_seed: int | None = 0,
    residual: bool = False,
    controls: Mapping[str, float] | None = None,
    hyperparameters: dict[str, bool | int | float | str | None] | None = None,
    **constant: float | None,
) -> Entry:
    """Metrics of an episode are within 0.1 of `level`, in [0, 1]; those in `constant` have a fixed value.

    controls: values of all metrics of a control, by default 0.1 of each that needs nothing but a policy. The
    draws depend only on the names; budgets rise from 0 to `level`, between 0 and 1.
    """
    rng = np.random.default_rng(derived_seed("made", policy, explainer, task, n_agents))
    seeds = episode_seeds(0, episodes)
    rows = tuple(_row(seed, level, n_agents, constant, rng) for seed in seeds)
    metrics = {name: _summary([getattr(row, name) for row in rows]) for name in Metrics.model_fields}
    levels = {**dict.fromkeys((*CONTROLS, NEAREST, INVERTED), 0.1), **(controls or {})}
    result = CellResult(
        task=task,
        n_agents=n_agents,
        max_cycles=TASKS[task].default_max_cycles,
        metrics=Metrics.model_validate(metrics),
        not_measured={"no_object_collision": "the task has no walls"},
        controls={name: _control(each, episodes) for name, each in levels.items()},
        behaviour_episodes=episodes,
        oracle=oracle,
        episodes=rows,
    )
    return make_entry(
        submitter=submitter,
        policy=PolicyRecord(
            name=policy,
            task=task,
            n_agents=n_agents if trained is None else trained,
            weights_sha256=f"{derived_seed(policy):064x}",
            architecture=ARCHITECTURE.model_copy(update={"residual": residual}),
            attention_entropy=attention_entropy,
            training_seed=training_seed,
        ),
        explainer=ExplainerRecord(
            name=explainer, distribution="made", version="1", entry_point=f"made:{explainer}",
            hyperparameters=hyperparameters or {}, stochastic=False, control=control, seed=0,
        ),
        protocol=Protocol(episodes=episodes, seeds=tuple(seeds), timesteps=None, definitions=DEFINITIONS),
        results=(result,),
        cost=Cost(explain_seconds_per_timestep=0.001, explained_timesteps=100,
                  shared_seconds_per_timestep=0.001, behaviour_seconds=1.0),
        provenance=Provenance(
            harness_version="0", commit=None, dirty=None, packages={}, python="3.11", os="none",
            machine="none", cpu="none", cpu_capability="none", threads=1, jobs=1, command="made",
            started="2026-01-01T00:00:00Z", finished="2026-01-01T00:00:00Z",
        ),
    )  # fmt: skip


def made_board(policies: Sequence[str], explainers: dict[str, float]) -> Iterator[Entry]:
    """Every explainer, with its level, on every policy; every second policy is regularised."""
    for k, policy in enumerate(policies):
        for explainer, level in explainers.items():
            yield made_entry(policy, explainer, level, n_agents=3 + k % 3, attention_entropy=0.5 * (k % 2))


@cache
def _control(level: float, episodes: int) -> ControlMetrics:
    return ControlMetrics.model_validate(
        {name: _summary([level] * episodes) for name in ControlMetrics.model_fields}
    )


def _row(
    seed: int, level: float, n_agents: int, constant: dict[str, float | None], rng: np.random.Generator
) -> EpisodeRow:
    values = np.clip(level + rng.uniform(-0.1, 0.1, len(SHARES)), 0.0, 1.0).tolist()
    drawn = dict(zip(SHARES, values, strict=True))
    drawn |= {"success_rate": 0.9, "no_agent_collision": 1.0, "communication_dependence": 0.5}
    drawn |= {"success_gain": 0.5, "reward_gain": 0.5}
    drawn |= {"attention_entropy": 0.5, "attention_distance": 0.5}  # of the policy, whatever explains it
    return EpisodeRow.model_validate(
        {
            **drawn,
            "seed": seed,
            "length": 50,
            "timesteps": 50,
            "budget": _budget(level, n_agents - 1),
            "comm_budget": _budget(level, n_agents - 2),
            "reward": 1.0,
            "no_object_collision": None,
            "makespan": 50.0,
            **constant,
        }
    )


def _budget(level: float, most: int) -> BudgetRow:
    def line(height: float) -> tuple[float, ...]:
        return tuple(height * (k + 1) / most for k in range(most))

    return BudgetRow(explained=line(level), random=line(0.0), oracle=line(1.0))


def _summary(values: Sequence[float | None]) -> Summary | None:
    """With a normal interval: a bootstrap of every metric would take most of a test's time."""
    numbers = [value for value in values if value is not None]
    if not numbers:
        return None
    mean, spread = float(np.mean(numbers)), 1.96 * float(np.std(numbers)) / len(numbers) ** 0.5
    interval = (mean - spread, mean + spread)
    return Summary(value=mean, interval=interval, n=len(numbers), n_nan=len(values) - len(numbers))
