"""results.json of a study: all data of its tables, captions and findings.

Derived from entries only, without paths: the same entries give the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from xmarl_bench.board.gate import gate_reason
from xmarl_bench.entry.schema import Entry
from xmarl_bench.metrics.student import Design, interval_of, mean_of
from xmarl_bench.papers.kailas2025.claims import ORIENTATION, Claim, Term
from xmarl_bench.papers.kailas2025.ledger import Judge, Judged, JudgedContrast, Verdict
from xmarl_bench.papers.kailas2025.lenses import LENSES
from xmarl_bench.papers.kailas2025.performance import performance
from xmarl_bench.papers.kailas2025.plan import Study
from xmarl_bench.papers.kailas2025.samples import Samples, percent_of
from xmarl_bench.policy import PolicyCard

SCHEMA = 4
# Metrics of the tables.
QUALITY = (
    "fid_delta", "gef", "fid_plus", "fid_minus", "comm_budgeted_fidelity", "budgeted_fidelity",
    "comm_fid_delta", "comm_gef", "behavioural_fidelity", "mask_mass",
)  # fmt: skip
Json = dict[str, Any]


@dataclass(frozen=True)
class StudyData:
    """The entries of a study."""

    study: Study
    explainers: tuple[str, ...]
    pairs: Sequence[tuple[PolicyCard, Entry]]
    samples: Samples
    existing: bool = False  # whether the entries are those of leaderboard/, so that nothing need be scored


def results_of(data: StudyData) -> Json:
    study, samples = data.study, data.samples
    judge = Judge(samples)
    protocol = data.pairs[0][1].protocol
    families = {card.family for card, _ in data.pairs}
    return {
        "schema": SCHEMA,
        "study": study.name,
        "title": study.title,
        "existing": data.existing,
        "protocol": {
            "id": protocol.id,
            "episodes": protocol.episodes,
            "timesteps": protocol.timesteps,
            "seeds": [protocol.seeds[0], protocol.seeds[-1]],
        },
        "explainers": _explainers(data),
        "families": [] if None in families else sorted(map(str, families)),  # none if one has no family
        "policies": _policies(data),
        "missing": missing(data),
        "core_hours": core_hours([entry for _, entry in data.pairs]),
        "quality": quality(data),
        "performance": performance(samples, study.cells),
        "ledger": [judged_record(judge.judge(claim)) for claim in study.claims],
        "beyond": [judged_record(judge.judge(claim)) for claim in study.beyond],
        "lenses": [
            {"name": lens.name, "text": lens.text, "claims": _seen(judge, study.claims, lens.apply)}
            for lens in LENSES
        ],
    }


def core_hours(entries: Sequence[Entry]) -> float:
    """Hours of one thread to explain, measure and play, as the entries measured it.

    What entries of a policy share (oracle, controls) counts once.
    """
    explained, shared = 0.0, dict[str, float]()
    for entry in entries:
        cost, where = entry.cost, f"{entry.policy.name} {[cell.n_agents for cell in entry.results]}"
        explained += cost.explain_seconds + cost.behaviour_seconds
        shared[where] = max(shared.get(where, 0.0), cost.shared_seconds)
    return (explained + sum(shared.values())) / 3600


def quality(data: StudyData) -> list[Json]:
    """Means of metrics over policies, with intervals, by cell, without or with the term, and by explainer."""
    records = []
    for cell, regularised, explainer in product(data.study.cells, (False, True), data.explainers):
        runs = data.samples.runs(cell, Term(explainer), regularised)
        for metric in QUALITY:
            blocks = {run: each[metric][~np.isnan(each[metric])] for run, each in runs.items()}
            kept = {run: float(x.mean()) for run, x in blocks.items() if x.size}
            # Runs of one architecture and seed share their start: several lambdas are one training.
            design = Design(clusters=tuple((run.architecture, run.seed) for run in kept))
            means = np.array(list(kept.values()))
            if means.size:
                records.append(
                    {
                        "cell": cell.label,
                        "regularised": regularised,
                        "explainer": explainer,
                        "metric": metric,
                        "mean": float(mean_of(means, design)),
                        "interval": interval_of(means, design=design),
                        "n_policies": means.size,
                    }
                )
    return records


def missing(data: StudyData) -> list[str]:
    """Cells without a policy."""
    return [
        f"{cell.label}, {'with' if regularised else 'without'} the term"
        for cell, regularised in product(data.study.cells, (False, True))
        if not data.samples.runs(cell, Term(data.explainers[0]), regularised)
    ]


def _explainers(data: StudyData) -> Json:
    records = {entry.explainer.name: entry.explainer for _, entry in data.pairs}
    return {
        name: {
            "distribution": record.distribution,
            "version": record.version,
            "hyperparameters": record.hyperparameters,
        }
        for name, record in sorted(records.items())
    }


def _policies(data: StudyData) -> list[Json]:
    """The policies in each cell; `gate` is the reason why the leaderboard would not rank one."""
    known: dict[tuple[str, int], Json] = {}
    for card, entry in data.pairs:
        (cell,) = entry.results
        known[card.name, cell.n_agents - card.n_agents] = {
            "name": card.name,
            "weights_sha256": card.weights_sha256,
            "task": card.task,
            "n_trained": card.n_agents,
            "n_tested": cell.n_agents,
            "percent": percent_of(card),
            "attention_entropy": card.attention_entropy,
            "training_seed": card.training_seed,
            "gate": gate_reason(cell.metrics),
        }
    return [known[key] for key in sorted(known)]


def _seen(judge: Judge, claims: Sequence[Claim], apply: Any) -> list[Json]:
    seen = [apply(claim) for claim in claims]
    return [judged_record(judge.judge(claim), cells=False) for claim in seen if claim is not None]


def judged_record(judged: Judged, *, cells: bool = True) -> Json:
    claim = judged.claim
    record: Json = {
        "id": claim.id,
        "lines": claim.lines,
        "section": claim.section,
        "text": claim.text,
        "quantifier": claim.quantifier.value,
        "verdict": judged.verdict.value,
        "counts": {verdict.value: judged.count(verdict) for verdict in Verdict},
        "overall": [_contrast(each) for each in judged.overall],
    }
    if cells:
        record["cells"] = [
            {
                "cell": each.cell.label,
                "verdict": each.verdict.value,
                "contrasts": [_contrast(contrast) for contrast in each.contrasts],
            }
            for each in judged.cells
        ]
    return record


def _contrast(judged: JudgedContrast) -> Json:
    contrast, compared = judged.contrast, judged.compared
    return {
        "metric": contrast.metric,
        "higher_is_better": ORIENTATION[contrast.metric] > 0,
        "relation": contrast.relation.value,
        "margin": contrast.margin,
        "compares": contrast.label,
        "a_mean": compared.a,
        "b_mean": compared.b,
        "difference": compared.difference,
        "interval": compared.interval,
        "p": compared.p,
        "p_adjusted": judged.p_adjusted,
        "p_beyond_adjusted": judged.p_beyond_adjusted,
        "effect": compared.effect,
        "n_policies": compared.n_policies,
        "n_episodes": compared.n_episodes,
        "n_nan": compared.n_nan,
        "verdict": judged.verdict.value,
    }
