"""Tests the metrics and writes what docs/metrics.md shows: three tables, degradation.png, agreement.png.

    .venv/bin/python docs/make_meta.py

Planted policies of 4, 6 and 8 agents; all finished shipped policies, 20 timesteps of each of their first 10
scoring episodes (every timestep of 5 for degenerate explanations). The agreement of metrics is read from
leaderboard/leaderboard.json, that of absence models on planted policies from every registered explainer
on 50 states. All draws have fixed seeds, so the same policies give the same tables.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from xmarl_bench.board.agreement import rank_agreement, scores_of_board
from xmarl_bench.meta.agreement import absences_agree, scores_of_planted
from xmarl_bench.meta.curves import METRICS, Curve, followed, planted_curves, states_of, trained_curves
from xmarl_bench.meta.degenerate import METRICS as OF_DEGENERATE
from xmarl_bench.meta.degenerate import RIGHT, Degenerate, degenerate_scores
from xmarl_bench.meta.degradation import NOISE, Form
from xmarl_bench.meta.planted_suite import score_planted
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.metrics.table import UNDER_ABSENCES, by_name
from xmarl_bench.policy import Policy, PolicyCard
from xmarl_bench.records.markdown import markdown_table, rewrite, with_part
from xmarl_bench.reproducible import one_thread
from xmarl_bench.scoring.selection import select_explainers, select_policies

HERE = Path(__file__).parent
# Okabe and Ito's, told apart by colour-blind people; dashes tell the forms.
COLOURS = {"planted": "#0072b2", "trained": "#d55e00"}
DASHES = {Form.SAME_VALUES: "-", Form.KEEPS_MORE: ":"}
DRAWN = (
    "fid_plus", "fid_minus", "fid_delta", "gef", "comm_fid_delta", "topk_fid_delta",
    "budgeted_fidelity", *UNDER_ABSENCES, "message_fidelity",
)  # fmt: skip
COMPARED = (  # what a row of the board has
    "fid_plus", "fid_minus", "fid_delta", "gef", "median_kl", "comm_fid_delta", "comm_gef",
    "budgeted_fidelity", *UNDER_ABSENCES, "message_fidelity", "smallest_message_fidelity",
    "weight_randomisation",
)  # fmt: skip
Suites = dict[str, list[Curve]]
Floats = NDArray[np.float64]


def title(name: str) -> str:
    metric = by_name()[name]
    return metric.title.replace("communication-only", "comm.").replace("budgeted fidelity", "budgeted")


def table_of_curves(suites: Suites) -> str:
    """Markdown: how well each metric follows the steps, in both forms."""
    header, rows = ["metric"], []
    for suite in suites:
        header += [suite, "smallest", "over policies", "worse keeps more"]
    for metric in METRICS:
        cells = []
        for curves in suites.values():
            same = followed(curves, metric, Form.SAME_VALUES)
            more = followed(curves, metric, Form.KEEPS_MORE)
            cells += [same.within, same.smallest, same.over, more.within]
        rows.append([by_name()[metric].title, *(f"{x:.2f}" for x in cells)])
    counts = [f"{len({each.policy for each in curves})} {suite}" for suite, curves in suites.items()]
    return f"Of {' and '.join(counts)} policies:\n\n{markdown_table(header, rows)}"


def table_of_degenerate(found: Sequence[Degenerate]) -> str:
    """Markdown: what metrics say of each kind, as a share of what they say of the right ranking."""
    headings, lines = [by_name()[name].title for name in OF_DEGENERATE], []
    right = {each.policy: each for each in found if each.kind == RIGHT}
    for kind in dict.fromkeys(each.kind for each in found):
        rows = [each for each in found if each.kind == kind]
        shares = [
            sum(each.values[name] for each in rows) / sum(right[each.policy].values[name] for each in rows)
            for name in OF_DEGENERATE
        ]
        checks = dict.fromkeys(check for each in rows for check in each.failed)
        said = [f"{check} ({sum(check in each.failed for each in rows)} of {len(rows)})" for check in checks]
        lines.append([kind, *(f"{x:.2f}" for x in shares), "; ".join(said) or "-"])
    return markdown_table(["explanation", *headings, "found by `check explainer`"], lines)


def table_of_absences(found: dict[str, Floats]) -> str:
    """Markdown: per policy, how far two absence models agree about who matters, over their six pairs."""
    pairs = {name: matrix[np.triu_indices(len(matrix), 1)] for name, matrix in found.items()}
    rows = [(name, f"{each.mean():.2f}", f"{each.min():.2f}") for name, each in pairs.items()]
    return markdown_table(("policy", "mean over pairs of models", "smallest"), rows)


def draw_curves(suites: Suites, path: Path) -> None:
    """A panel for each metric: its value at every step, mean over policies."""
    figure, axes = plt.subplots(3, 4, figsize=(11, 7.4), sharex=True, layout="constrained")
    for axis, metric in zip(axes.flat, DRAWN, strict=True):
        for suite, curves in suites.items():
            for form in Form:
                asked = [each.values for each in curves if (each.metric, each.form) == (metric, form)]
                mean = np.nanmean(asked, axis=0)
                axis.plot(mean, DASHES[form], color=COLOURS[suite], linewidth=2, label=f"{suite}, {form}")
        better = by_name()[metric].direction.arrow
        axis.set_title(f"{title(metric)} {better}", fontsize=10)
        axis.set_xticks(range(len(NOISE)), [f"{noise:g}" for noise in NOISE], fontsize=8)
        axis.tick_params(axis="y", labelsize=8)
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=9)
    figure.supxlabel("noise in the right ranking: 0 is right, to the right it gets worse", fontsize=10)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_agreement(metrics: Floats, absences: dict[str, Floats], path: Path) -> None:
    """Heatmaps: metrics on the left, absence models on the right."""
    figure = plt.figure(figsize=(13.5, 8.2), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=[2.6, 1], squeeze=False)[0]
    axis = left.subplots()
    heatmap(axis, metrics, [title(name) for name in COMPARED], size=7.5)
    axis.set_title("do two metrics order explainers alike? (mean over policies of the board)", fontsize=10)
    for axis, (name, matrix) in zip(right.subplots(len(absences), 1), absences.items(), strict=True):
        heatmap(axis, matrix, [str(each) for each in Absence], size=9)
        axis.set_title(name, fontsize=10)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def heatmap(axis: Axes, matrix: Floats, names: Sequence[str], size: float) -> None:
    """Rank correlations: orange to purple by way of white, which colour-blind people see, and the numbers."""
    axis.imshow(matrix, cmap="PuOr", vmin=-1.0, vmax=1.0)
    axis.set_xticks(range(len(names)), names, rotation=40, ha="right", fontsize=size + 1)
    axis.set_yticks(range(len(names)), names, fontsize=size + 1)
    axis.tick_params(length=0)
    for (row, column), value in np.ndenumerate(matrix):
        text = "-" if np.isnan(value) else f"{value:.2f}".replace("-0.00", "0.00")
        ink = "white" if abs(value) > 0.6 else "black"
        axis.text(column, row, text, ha="center", va="center", color=ink, fontsize=size)


def partner(policies: Sequence[tuple[Policy, PolicyCard]], k: int) -> Policy:
    """The next policy of the same task: whose explanations are copied."""
    same = [j for j, (_, card) in enumerate(policies) if card.task == policies[k][1].task]
    return policies[same[(same.index(k) + 1) % len(same)]][0]


def main() -> None:
    policies = [(policy, card) for policy, card, _ in select_policies(["finished"], ["all"], ["all"])]
    suites: Suites = {
        "planted": list(planted_curves()),
        "trained": [each for policy, card in policies for each in trained_curves(policy, card)],
    }
    degenerate = [
        each
        for k, (policy, card) in enumerate(policies)
        for each in degenerate_scores(policy, card, partner(policies, k))
    ]
    board = scores_of_board(
        json.loads((HERE.parent / "leaderboard" / "leaderboard.json").read_bytes())["tables"]
    )
    planted = scores_of_planted(score_planted(select_explainers(["all"])[0], n_steps=50))
    with one_thread():
        who_matters = {
            card.name: absences_agree(
                states for states, _ in states_of(policy, card, episodes=10, timesteps=20, seed=0)
            )
            for policy, card in policies
        }
    absences = {
        "order of explainers, trained policies": rank_agreement(board, UNDER_ABSENCES),
        "order of explainers, planted policies": rank_agreement(planted, UNDER_ABSENCES),
        "who matters to a receiver, trained": np.mean(list(who_matters.values()), axis=0),
    }
    draw_curves(suites, HERE / "degradation.png")
    draw_agreement(rank_agreement(board, COMPARED), absences, HERE / "agreement.png")
    for name, part in (
        ("followed", table_of_curves(suites)),
        ("absences", table_of_absences(who_matters)),
        ("degenerate", table_of_degenerate(degenerate)),
    ):
        rewrite(HERE / "metrics.md", partial(with_part, name=name, part=part))


if __name__ == "__main__":
    main()
