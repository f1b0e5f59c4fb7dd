"""Scores explainers on planted truth: do they find the messages that matter, and does the referee agree?

Beside each explainer's AUROC and average precision stands its message fidelity on the same policy and states,
the order of the leaderboard. Kendall's tau between the two orders says whether the referee can be believed.
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
from xmarl_bench.planted.families import CODES, FAMILIES, Planted, planted
from xmarl_bench.planted.truth import auroc, average_precision
from xmarl_bench.reproducible import derived_seed, one_thread
from xmarl_bench.scoring.states import States

SIZES = (4, 6, 8)  # by default
FLOORS = ("random", "all-ones")


@dataclass(frozen=True)
class Found:
    """What an explainer found of one family, or why it could not be asked."""

    family: str
    n_agents: int
    explainer: str
    control: bool
    auroc: float | None
    average_precision: float | None
    fidelity: float | None  # the order of the leaderboard
    under: dict[str, float | None]  # budgeted fidelity under each absence model
    error: str | None = None


def score_planted(
    explainers: Sequence[Explainer], *, sizes: Sequence[int] = SIZES, n_steps: int = 100, seed: int = 0
) -> list[Found]:
    """Every explainer, and the floors, on every family that a team of these sizes can have."""
    if any(not 3 <= size <= CODES for size in sizes):
        raise InputError(f"planted teams have 3 to {CODES} agents, got {list(sizes)}: choose from these.")
    asked = {each.name: each for each in (*(CONTROLS[name] for name in FLOORS), *explainers)}
    found = []
    with one_thread():
        for family, rule in FAMILIES.items():
            for n_agents in sizes:
                if n_agents >= rule.fewest:
                    truth = planted(family, n_agents, n_steps=n_steps, seed=seed)
                    found += _found(truth, n_agents, list(asked.values()), seed)
    return found


def _found(truth: Planted, n_agents: int, explainers: Sequence[Explainer], seed: int) -> list[Found]:
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
            found.append(Found(*who, None, None, None, dict.fromkeys(UNDER_ABSENCES), str(error)))
            continue
        row, where = states.mask_metrics(mask), (mask.numpy(), truth.relevant, truth.counted)
        under = {name: getattr(row, name) for name in UNDER_ABSENCES}
        found.append(Found(*who, auroc(*where), average_precision(*where), getattr(row, ORDER), under))
    return found


def agreement(found: Sequence[Found]) -> float | None:
    """Kendall's tau-b of explainers' mean AUROC and mean message fidelity; None for fewer than three."""
    from scipy.stats import kendalltau

    means = list(means_of(found).values())
    if len(means) < 3:
        return None
    return float(
        kendalltau([each["auroc"] for each in means], [each["fidelity"] for each in means]).statistic
    )


def means_of(found: Sequence[Found]) -> dict[str, dict[str, float]]:
    """Explainer -> means over families of those over sizes, best AUROC first; of who answered everywhere."""
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


def by_family(found: Sequence[Found], name: str, field: str) -> dict[str, float]:
    """Family -> mean of an explainer's field over team sizes, of those that are numbers."""
    values: dict[str, list[float]] = {}
    for each in found:
        value = getattr(each, field)
        if each.explainer == name and value is not None:
            values.setdefault(each.family, []).append(value)
    return {family: float(np.mean(each)) for family, each in values.items()}


def _mean(found: Sequence[Found], name: str, field: str) -> float:
    return float(np.mean(list(by_family(found, name, field).values())))


def record(found: Sequence[Found], seed: int) -> Mapping[str, Any]:
    """As JSON."""
    return {
        "suite": "planted",
        "seed": seed,
        "agreement": agreement(found),
        "means": means_of(found),
        "found": [asdict(each) for each in found],
    }
