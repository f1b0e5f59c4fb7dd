"""Writes docs/dose.md and its picture: what more of the attention-entropy term does to attention.

    .venv/bin/python docs/make_dose.py

from the records that `python -m xmarl_baselines.dose` wrote. No number on the page is typed by hand;
tests/docs/test_dose_page.py fails if it is stale.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import kendalltau, page_trend_test
from xmarl_baselines.dose import RECORDS

from xmarl_bench.counted import counted
from xmarl_bench.metrics.statistics import Difference, over_runs
from xmarl_bench.metrics.student import CONFIDENCE
from xmarl_bench.records.markdown import from_template

DOCS = Path(__file__).parent
BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#808080"  # Okabe and Ito
COLUMNS = {
    "message_fidelity": "message fidelity of attention",
    "attention_entropy": "attention entropy (nats)",
    "success": "success",
    "no_agent_collision": "no agent collision",
    "success_without_messages": "success without messages",
}
NEAREST, LEAD = "nearest", "lead over nearest"  # message fidelity of the control, and of attention above it
Runs = dict[float, dict[int, dict[str, Any]]]  # lambda -> seed -> record


def runs_of(records: Sequence[dict[str, Any]]) -> Runs:
    runs: Runs = {}
    for record in sorted(records, key=lambda each: (each["lambda"], each["seed"])):
        nearest = record["controls"][NEAREST]["message_fidelity"]
        derived = {NEAREST: nearest, LEAD: record["message_fidelity"] - nearest}
        runs.setdefault(record["lambda"], {})[record["seed"]] = {**record, **derived}
    return runs


def against_none(runs: Runs, weight: float, metric: str) -> Difference:
    """With the term less without it, paired by seed: until the term sets in, both runs are the same."""
    seeds = sorted(runs[weight].keys() & runs[0.0].keys())
    return over_runs(*([[runs[each][seed][metric]] for seed in seeds] for each in (weight, 0.0)))


class Trend(NamedTuple):
    """Of a metric along lambda, within the seeds that have every lambda."""

    tau: float  # Kendall's, mean over seeds; NaN if the metric is constant
    p: float  # of Page's test, two-sided: do the seeds order the lambdas alike?
    n: int

    @property
    def decided(self) -> bool:
        return self.p < 1.0 - CONFIDENCE

    def __str__(self) -> str:
        small = "p under 0.001" if self.p < 0.001 else f"p {self.p:.3f}"
        return "undefined" if np.isnan(self.tau) else f"{self.tau:+.2f} ({small})"


def trend(runs: Runs, metric: str) -> Trend:
    seeds = sorted(set.intersection(*(set(each) for each in runs.values())))
    values = np.array([[of[seed][metric] for of in runs.values()] for seed in seeds])
    taus = np.array([kendalltau(list(runs), each).statistic for each in values])
    tau = float(taus[~np.isnan(taus)].mean()) if not np.isnan(taus).all() else float("nan")
    one_sided = [page_trend_test(sign * values, method="exact").pvalue for sign in (1.0, -1.0)]
    return Trend(tau, min(1.0, 2.0 * float(min(one_sided))), len(seeds))


def answer(runs: Runs) -> str:
    """The first sentences of the page."""
    found = trend(runs, "message_fidelity")
    said = f"More of the term makes attention {'truer' if found.tau > 0 else 'less true'}"
    if not found.decided:
        said = "It is not decided whether more of the term makes attention truer"
    differences = {each: against_none(runs, each, "message_fidelity") for each in runs if each > 0.0}
    decided = "".join(
        f"With lambda {weight:g} message fidelity differs from that without the term by "
        f"{difference}, over {counted(difference.units, 'seed')}. "
        for weight, difference in differences.items()
        if difference.interval is not None and not difference.holds_zero
    )
    best = max(runs, key=lambda each: mean(runs[each], "message_fidelity"))
    return (
        f"{said}: within a seed, Kendall's tau of lambda and message fidelity is {found}, over "
        f"{counted(found.n, 'seed')}. {decided}It is highest at lambda {best:g}, "
        f"with {mean(runs[best], 'message_fidelity'):.2f} "
        f"against {mean(runs[0.0], 'message_fidelity'):.2f} without the term. "
        f"Tau of lambda and success is {trend(runs, 'success')}, of lambda and the episodes without agents "
        f"touching {trend(runs, 'no_agent_collision')}. {beside_nearest(runs)}"
    )


def beside_nearest(runs: Runs) -> str:
    """Whether the control that never looks at a policy changes as attention does."""
    most = max(runs)
    near, lead = (against_none(runs, most, metric) for metric in (NEAREST, LEAD))
    said = (
        f"At lambda {most:g} the control `nearest`, which never looks at a policy, changes by {near}, and "
        f"the lead of attention over it by {lead}."
    )
    if near.holds_zero or not lead.holds_zero:
        return said
    return (
        f"{said} So it is not shown that attention gains more than this control does: with the term, the "
        f"messages of near agents matter more in this cell."
    )


def mean(runs: dict[int, dict[str, Any]], metric: str) -> float:
    return float(np.mean([each[metric] for each in runs.values()]))


def rows(runs: Runs) -> list[list[str]]:
    """A line for each lambda: means over seeds, and differences to the same seeds without the term."""
    lines = []
    for weight, of_seeds in runs.items():
        cells = [f"{weight:g}", str(len(of_seeds))]
        for metric in COLUMNS:
            cells.append(f"{mean(of_seeds, metric):.2f}")
            if weight > 0.0:
                cells[-1] += f" ({against_none(runs, weight, metric)})"
        for control in ("initial-attention", NEAREST):
            values = [each["controls"][control]["message_fidelity"] for each in of_seeds.values()]
            cells.append(f"{np.mean(values):.2f}")
        lines.append(cells)
    return lines


def page(runs: Runs) -> str:
    said = textwrap.fill(answer(runs), 118)
    return from_template(DOCS / "dose.md.jinja", answer=said, columns=COLUMNS, rows=rows(runs))


def draw(runs: Runs, path: Path) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained")
    panels = (
        ("message fidelity of attention", (("message_fidelity", BLUE, "o-", None),)),
        ("attention entropy (nats)", (("attention_entropy", BLUE, "o-", None),)),
        (
            "share of episodes",
            (
                ("success", BLUE, "o-", "success"),
                ("no_agent_collision", ORANGE, "s--", "no agent collision"),
                ("success_without_messages", GREY, "^:", "success without messages"),
            ),
        ),
    )
    for axis, (title, lines) in zip(axes, panels, strict=True):
        for metric, colour, style, label in lines:
            axis.plot([mean(each, metric) for each in runs.values()], style, color=colour, label=label)
            for x, of_seeds in enumerate(runs.values()):
                values = [each[metric] for each in of_seeds.values()]
                axis.plot([x] * len(values), values, style[0], color=colour, alpha=0.35, markersize=4)
        axis.set_xticks(range(len(runs)), [f"{weight:g}" for weight in runs])
        axis.set_xlabel("lambda")
        axis.set_title(title, fontsize=10)
        axis.spines[["top", "right"]].set_visible(False)
    axes[-1].legend(fontsize=7)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def made() -> tuple[str, Runs]:
    """The page, and the runs that it is made of."""
    runs = runs_of([json.loads(path.read_bytes()) for path in sorted(RECORDS.glob("*.json"))])
    return page(runs), runs


if __name__ == "__main__":
    text, found_runs = made()
    draw(found_runs, DOCS / "dose.png")
    (DOCS / "dose.md").write_text(text, encoding="utf-8", newline="\n")
