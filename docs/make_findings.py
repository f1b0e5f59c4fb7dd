"""Writes docs/findings.md and its pictures: six answers, in sentences made from leaderboard/leaderboard.json.

    .venv/bin/python docs/make_findings.py

No number or comparison on the page is typed by hand. Run it after the board was built;
tests/docs/test_findings_page.py fails until then.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from scipy.stats import spearmanr
from xmarl_envs import TASKS

from xmarl_bench.board.answer import answer_on_term, difference, effect_of
from xmarl_bench.board.ranking import DIGITS
from xmarl_bench.board.regulariser import compared, families_of, kind_of, score_of, task_metric_of, values_of
from xmarl_bench.board.robustness import answer_by, others_with_term, rests_on_zero, with_gated_pairs
from xmarl_bench.board.scores import Scores
from xmarl_bench.counted import counted
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.metrics.statistics import Difference
from xmarl_bench.metrics.table import ORDER, UNDER_ABSENCES
from xmarl_bench.records.markdown import from_template

ROOT = Path(__file__).parent.parent
# Okabe and Ito's colours, told apart by colour-blind people.
BLUE, ORANGE, GREEN, PINK, GREY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b0b0b0"
STYLES = (BLUE, "-"), (ORANGE, "--"), (GREEN, ":"), (PINK, "-.")
CONTROLS = "random", "all-ones", "initial-attention", "nearest"
N_KINDS = 3 * len(TASKS) * 2  # teams of 3, 4, 5; with and without the term
MODEL_OF = dict(zip(UNDER_ABSENCES, Absence, strict=True))


def more(difference: Difference, up: str, down: str, open_: str) -> str:
    """Which of three words the interval allows."""
    assert difference.value is not None
    return open_ if difference.holds_zero else up if difference.value > 0 else down


def of(scores: Scores, a: str, b: str) -> str:
    """Message fidelity of a less that of b, with its interval."""
    return str(scores.difference(ORDER, a, b))


def dots(axis: Axes, scores: Scores, names: Sequence[str]) -> None:
    """A line for each name: a dot for each policy, and a bar at the mean; controls are grey."""
    for y, name in enumerate(names):
        values, colour = scores.of_policies(ORDER, name), GREY if name in CONTROLS else BLUE
        axis.plot(values, [y] * len(values), "o", color=colour, alpha=0.35, markersize=4, markeredgewidth=0)
        axis.plot(scores.mean(ORDER, name), y, "|", color=colour, markersize=13, markeredgewidth=2.5)
    axis.set_yticks(range(len(names)), names, fontsize=8)
    axis.axvline(0, color="black", linewidth=0.6)
    axis.set_xlabel("message fidelity: a dot for each policy, a bar for their mean")


def legend_above(axis: Axes, n_columns: int) -> None:
    """One entry for each label, above the axes."""
    labels = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    place: Any = {"loc": "lower left", "bbox_to_anchor": (0, 1), "frameon": False}
    axis.legend(labels.values(), labels, fontsize=8, ncols=n_columns, **place)


@dataclass(frozen=True)
class Finding:
    name: str  # of its picture
    title: str
    text: str
    draw: Callable[[Axes], None]
    alt: str


def who_leads(scores: Scores) -> Finding:
    best, *others = scores.tied
    text = " ".join(answer_by(scores))

    def draw(axis: Axes) -> None:
        dots(axis, scores, [*CONTROLS, *reversed(scores.explainers)])
        axis.set_xlabel(f"{axis.get_xlabel()}; controls are grey")

    if others:
        title = "Several explainers lead, and none leads surely"
    else:
        title = (
            f"{best} leads, by the absence model zero" if rests_on_zero(scores) else f"{best} leads surely"
        )
    return Finding("leaders", title, text, draw, "Message fidelity of every explainer and four controls")


def fid_delta_misleads(scores: Scores) -> Finding:
    best = scores.tied[0]
    lead = scores.difference("fid_delta", "all-ones", best)
    text = (
        f"The mask of ones says that everybody influences everybody. Its FidDelta is "
        f"{scores.mean('fid_delta', 'all-ones'):.2f}, that of {best} {scores.mean('fid_delta', best):.2f}: "
        f"{lead} for the mask that explains nothing. FidDelta also rewards a mask for how much "
        f"it keeps. In message fidelity the mask of ones has {scores.mean(ORDER, 'all-ones'):.2f}."
    )

    def draw(axis: Axes) -> None:
        for name in [*scores.explainers, *CONTROLS]:
            at = scores.mean("fid_delta", name), scores.mean(ORDER, name)
            axis.plot(*at, "o", color=ORANGE if name in CONTROLS else BLUE)
            if name in CONTROLS or name in (best, scores.explainers[-1]):
                axis.annotate(name, at, xytext=(5, 4), textcoords="offset points", fontsize=8)
        axis.margins(0.15)
        axis.set_xlabel("FidDelta; controls are orange")
        axis.set_ylabel("message fidelity")

    title = more(
        lead, "A high FidDelta alone proves nothing", *2 * ["FidDelta tells the best from the mask of ones"]
    )
    return Finding("fid-delta", title, text, draw, "FidDelta against message fidelity")


def absence_decides(scores: Scores) -> Finding:
    first = {
        metric: max(scores.explainers, key=lambda name, metric=metric: scores.mean(metric, name))  # type: ignore[misc]
        for metric in UNDER_ABSENCES
    }
    best = scores.explainers[0]
    above = {metric: scores.difference(metric, name, best) for metric, name in first.items() if name != best}
    said = ", ".join(
        f"{name} under `{MODEL_OF[metric]}` ({scores.mean(metric, name):.2f}"
        + (f"; {above[metric]} above {best})" if metric in above else ")")
        for metric, name in first.items()
    )
    three, to_four = (scores.only(lambda policy, n=n: policy["n_agents"] <= n) for n in (3, 4))  # type: ignore[misc]
    zero, mean = (three.mean(metric, "occlusion") for metric in UNDER_ABSENCES[:2])
    shapley = to_four.mean(UNDER_ABSENCES[0], "shapley-messages")
    text = (
        f"Something has to stand in for a message that is removed. First is {said}. With three agents the "
        f"score under `zero` is occlusion's own definition: it has {zero:.2f} there by construction, and "
        f"{mean:.2f} under `mean`. The same holds of shapley-messages with up to four agents, "
        f"{shapley:.2f} under `zero`, and with three agents it ranks messages exactly as occlusion does. "
        f"`influence` removes messages by `resample`. So the leaderboard averages over all four, and shows "
        f"the smallest; an average of four is a choice too."
    )

    def draw(axis: Axes) -> None:
        styles = dict(zip(dict.fromkeys(first.values()), STYLES, strict=False))
        for name in scores.explainers:
            values = [scores.mean(metric, name) for metric in UNDER_ABSENCES]
            colour, dash = styles.get(name, (GREY, "-"))
            axis.plot(values, f"o{dash}", color=colour, label=name if name in styles else None)
        axis.set_xticks(range(len(MODEL_OF)), list(MODEL_OF.values()))
        axis.set_ylabel("budgeted fidelity")
        legend_above(axis, 4)

    title = f"{best} is first under all absence models"
    if above:
        sure = any(not each.holds_zero for each in above.values())
        title = f"What stands in for a missing message {'decides' if sure else 'may decide'} who is first"
    return Finding("absence", title, text, draw, "Budgeted fidelity under four absence models")


def attention_is_learnt(scores: Scores) -> Finding:
    controls = "initial-attention", "nearest"
    before, near = (scores.difference(ORDER, "attention", each) for each in controls)
    parts = {
        task.split("_")[1]: scores.only(lambda policy, task=task: policy["task"] == task)  # type: ignore[misc]
        for task in sorted({policy["task"] for policy in scores.policies})
    }
    by_task = ", ".join(f"{of(part, 'attention', controls[1])} in {task}" for task, part in parts.items())
    learnt = more(before, "was learnt", "is worse after training", "may come from its initialisation")
    beyond = more(near, "is more than", "is less than", "may be no more than")
    text = (
        f"Attention has {scores.mean(ORDER, 'attention'):.2f}. The attention of the same network before its "
        f"training has {scores.mean(ORDER, controls[0]):.2f}: {before} for the trained one. The "
        f"nearest agent, which never looks at the policy, has {scores.mean(ORDER, controls[1]):.2f}: "
        f"{near}. So what attention says {learnt}, and {beyond} who stands near whom. By task, attention "
        f"less the nearest agent is {by_task}."
    )

    def draw(axis: Axes) -> None:
        series = zip(("attention", *controls), "oD^", (BLUE, ORANGE, GREY), strict=True)
        for name, marker, colour in series:
            axis.plot(scores.of_policies(ORDER, name), marker, color=colour, label=name)
        cells = [re.sub("-residual|-seed[0-9]+", "", policy["name"]) for policy in scores.policies]
        at = {cell: np.mean([k for k, each in enumerate(cells) if each == cell]) for cell in cells}
        axis.set_xticks(list(at.values()), list(at), rotation=90, fontsize=7)
        axis.axhline(0, color="black", linewidth=0.6)
        axis.set_ylabel("message fidelity")
        legend_above(axis, 3)

    titles = "Attention tells what training put there", "Training makes attention worse"
    title = more(before, *titles, "Attention may be our initialisation")
    return Finding("attention", title, text, draw, "Attention beside two controls that saw no training")


def defaults_fail(scores: Scores) -> Finding:
    best, chance = scores.explainers[0], scores.difference(ORDER, "gnn_explainer", "random")
    gap = scores.difference(ORDER, "gnn_explainer-tuned", best)
    part = more(gap, "all", "a part", "maybe all")
    compared = more(
        chance, "better than a random mask", "worse than a random mask", "no better than a random mask"
    )
    text = (
        f"GNNExplainer with torch_geometric's defaults has {scores.mean(ORDER, 'gnn_explainer'):.2f} and is "
        f"{compared}: {chance}. Settings that fit policies add "
        f"{of(scores, 'gnn_explainer-tuned', 'gnn_explainer')}; with them it differs from {best} by {gap}. "
        f"So defaults made for other graphs are {part} of the fault. The settings were chosen on policies "
        f"that no score plays. Defaults less the nearest agent: {of(scores, 'gnn_explainer', 'nearest')}. "
        f"GraphMask asked about messages alone, an agent always hearing itself, changes by "
        f"{of(scores, 'graphmask-messages', 'graphmask')}."
    )

    def draw(axis: Axes) -> None:
        names = ["random", "graphmask-messages", "graphmask", "gnn_explainer-tuned", "gnn_explainer"]
        dots(axis, scores, names)

    title = f"GNNExplainer's defaults are {compared.replace('a random mask', 'chance')}"
    return Finding("defaults", title, text, draw, "GNNExplainer and GraphMask in several forms")


def regulariser(scores: Scores) -> Finding:
    families = families_of(scores.tables)
    attention = partial(score_of, explainer="attention")
    gain = compared(families, attention)
    said = [answer_on_term("attention", gain), others_with_term(families, "attention", scores.explainers[0])]
    entropy, success = (
        compared(families, partial(task_metric_of, metric=metric))
        for metric in ("attention_entropy", "success_rate")
    )
    if entropy is not None and success is not None:
        said.append(
            f"Attention entropy changes by {difference(entropy)} nats, success by {difference(success)}."
        )
    said.append(with_gated_pairs(scores.tables, "attention"))
    text = " ".join(each for each in said if each)

    def draw(axis: Axes) -> None:
        styles = dict(zip(sorted(TASKS), zip("o^s", (BLUE, ORANGE, GREEN), strict=True), strict=True))
        for family, *each in values_of(families, attention):
            (marker, colour), task = styles[family["task"]], family["task"].split("_")[1]
            axis.plot(each, f"{marker}-", color=colour, label=task)
        axis.set_xticks([0, 1], ["without the term", "with it"])
        axis.set_xlim(-0.2, 1.2)
        legend_above(axis, 3)
        axis.set_ylabel("message fidelity of attention")

    effect = "may or may not change" if gain is None else effect_of(gain)
    title = f"Attention-entropy regularisation {effect} message fidelity of attention"
    return Finding("entropy", title, text, draw, "Message fidelity of attention without and with the term")


FINDINGS = who_leads, fid_delta_misleads, absence_decides, attention_is_learnt, defaults_fail, regulariser


def firsts(of: dict[str, float]) -> str:
    """The explainers of the largest value, equal ones together, with their verb."""
    names = [f"`{name}`" for name, value in of.items() if round(max(of.values()) - value, DIGITS) == 0.0]
    return f"{names[0]} is" if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} are"


def by_family(scores: Scores) -> str:
    """Whether both families order the explainers alike."""
    kinds = [kind_of(policy["architecture"]) for policy in scores.policies]
    means = {}
    for family in sorted(set(kinds)):
        its = scores.only(lambda policy, family=family: kind_of(policy["architecture"]) == family)  # type: ignore[misc]
        means[family] = {name: its.mean(ORDER, name) for name in scores.explainers}
    said = "; ".join(
        f"in `{family}`, {counted(kinds.count(family), 'policy')}, {firsts(of)} first "
        f"({max(of.values()):.2f}) and `attention` has {of['attention']:.2f}"
        for family, of in means.items()
    )
    end = "Other families are open."
    if len(means) == 2:
        one, other = (list(of.values()) for of in means.values())
        end = f"Spearman's correlation of both orders is {spearmanr(one, other)[0]:.2f}."
    return f"{said[0].upper()}{said[1:]}. {end}"


def undecided(scores: Scores) -> list[str]:
    """What the policies of the board cannot answer."""
    kinds = Counter(
        (each["task"], each["n_agents"], bool(each["attention_entropy"])) for each in scores.policies
    )
    most, single = max(kinds.values()), sum(n == 1 for n in kinds.values())
    lines = [
        f"- **Runs.** {len(scores.policies)} policies. Of {N_KINDS} kinds (a cell, with or without the term) "
        f"{len(kinds)} have a policy, {single} only one, and none has more than {most}. How far runs of one "
        f"cell spread is " + ("not known." if most == 1 else "known for some cells only."),
        "- **One dose.** On the board each task has one weight of the entropy term. "
        "[dose.md](dose.md) has several, of one cell.",
    ]
    return lines


def wrapped(text: str, indent: str = "") -> str:
    return "\n".join(textwrap.wrap(text, 118, subsequent_indent=indent, break_on_hyphens=False))


def page(findings: Sequence[Finding], scores: Scores) -> str:
    template, filters = ROOT / "docs" / "findings.md.jinja", {"wrapped": wrapped}
    parts = {"undecided": undecided(scores), "by_family": by_family(scores)}
    return from_template(template, filters, findings=findings, **parts)


def draw(finding: Finding, path: Path) -> None:
    tall = 5.2 if finding.name == "leaders" else 3.6
    figure, axis = plt.subplots(figsize=(7.5, tall), layout="constrained")
    finding.draw(axis)
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def made() -> tuple[str, list[Finding]]:
    """The page and its findings, from the board as it is."""
    scores = Scores.of(json.loads((ROOT / "leaderboard" / "leaderboard.json").read_bytes()))
    findings = [find(scores) for find in FINDINGS]
    return page(findings, scores), findings


if __name__ == "__main__":
    made_page, found = made()
    for each in found:
        draw(each, ROOT / "docs" / f"findings-{each.name}.png")
    (ROOT / "docs" / "findings.md").write_text(made_page, encoding="utf-8", newline="\n")
