"""Scores explainers on planted truth: do they find the relevant messages, and does the leaderboard agree?

Each explainer gets AUROC and average precision against the truth, and its message fidelity, by which the
leaderboard is ordered, on the same policy and states. Kendall's tau between the two orders tells whether the
leaderboard's order can be trusted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from xmarl_bench.errors import InputError
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.explain.explainer import Explainer, fit_explainer, run_explainer
from xmarl_bench.metrics.table import ORDER, UNDER_ABSENCES
from xmarl_bench.planted.families import CODES, SIZES, Planted, planted, teams
from xmarl_bench.planted.truth import auroc, average_precision
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.scoring.states import States

ALWAYS_SCORED = ("random", "all-ones")


@dataclass(frozen=True)
class PlantedScore:
    """An explainer's score on one family and team size, or why it could not be scored."""

    family: str
    n_agents: int
    explainer: str
    control: bool
    auroc: float | None
    average_precision: float | None
    fidelity: float | None  # message fidelity, by which the leaderboard is ordered
    under: dict[str, float | None]  # budgeted fidelity under each absence model
    error: str | None = None


def score_planted(
    explainers: Sequence[Explainer], *, sizes: Sequence[int] = SIZES, n_steps: int = 100, seed: int = 0
) -> list[PlantedScore]:
    """Score every explainer, and the controls `ALWAYS_SCORED`, on every family, where it takes the size."""
    if any(not 3 <= size <= CODES for size in sizes):
        raise InputError(f"planted teams have 3 to {CODES} agents, got {list(sizes)}: choose from these.")
    scored = {each.name: each for each in (*(CONTROLS[name] for name in ALWAYS_SCORED), *explainers)}
    found = []
    with one_thread():
        for family, n_agents in teams(sizes):
            truth = planted(family, n_agents, n_steps=n_steps, seed=seed)
            found += _score(truth, n_agents, list(scored.values()), seed)
    return found


def _score(truth: Planted, n_agents: int, explainers: Sequence[Explainer], seed: int) -> list[PlantedScore]:
    rng = np.random.default_rng(derived_seed("planted", seed, truth.family, n_agents))
    states = States.of(truth.policy, truth.observations, rng, truth.reference)
    found = []
    for explainer in explainers:
        who = truth.family, n_agents, explainer.name, explainer.control
        drawn = derived_seed("planted", seed, explainer.name, truth.family, n_agents)
        try:
            ready = fit_explainer(explainer, truth.policy, truth.reference, drawn)
            mask = run_explainer(ready, truth.policy, truth.observations, drawn)
        except InputError as error:
            found.append(PlantedScore(*who, None, None, None, dict.fromkeys(UNDER_ABSENCES), str(error)))
            continue
        row, where = states.mask_metrics(mask), (mask.numpy(), truth.relevant, truth.counted)
        under = {name: getattr(row, name) for name in UNDER_ABSENCES}
        scores = auroc(*where), average_precision(*where), getattr(row, ORDER)
        found.append(PlantedScore(*who, *scores, under))
    return found


def agreement(found: Sequence[PlantedScore]) -> float | None:
    """Kendall's tau-b of explainers' mean AUROC and mean message fidelity; None for fewer than three."""
    from scipy.stats import kendalltau

    means = list(means_of(found).values())
    if len(means) < 3:
        return None
    return float(
        kendalltau([each["auroc"] for each in means], [each["fidelity"] for each in means]).statistic
    )


def means_of(found: Sequence[PlantedScore]) -> dict[str, dict[str, float]]:
    """Explainer -> means over sizes, then over families, best AUROC first. Omits explainers that failed."""
    names = dict.fromkeys(each.explainer for each in found)
    failed = {each.explainer for each in found if each.error is not None}
    means = {
        name: {
            "auroc": _mean(found, name, "auroc"),
            "precision": _mean(found, name, "average_precision"),
            "fidelity": _mean(found, name, "fidelity"),
        }
        for name in names
        if name not in failed
    }
    return dict(sorted(means.items(), key=lambda pair: (-pair[1]["auroc"], pair[0])))


def by_family(found: Sequence[PlantedScore], name: str, field: str) -> dict[str, float]:
    """Family -> mean of an explainer's field over the team sizes where it is a number."""
    values: dict[str, list[float]] = {}
    for each in found:
        value = getattr(each, field)
        if each.explainer == name and value is not None:
            values.setdefault(each.family, []).append(value)
    return {family: float(np.mean(each)) for family, each in values.items()}


def _mean(found: Sequence[PlantedScore], name: str, field: str) -> float:
    return float(np.mean(list(by_family(found, name, field).values())))


def record(found: Sequence[PlantedScore], seed: int) -> Mapping[str, Any]:
    """The scores and their summary, as written to JSON."""
    return {
        "suite": "planted",
        "seed": seed,
        "agreement": agreement(found),
        "means": means_of(found),
        "found": [asdict(each) for each in found],
    }
