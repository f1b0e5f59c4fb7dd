"""Writes the policies' tables of both READMEs and docs/learning.png from cards and controls.

    python -m xmarl_baselines.report [--zero-shot]

`--zero-shot` first measures every navigation policy with more agents than it was trained with (minutes) into
zero_shot.json; without it the existing file is used.
"""

from __future__ import annotations

import json
from collections import defaultdict
from functools import cache
from pathlib import Path
from statistics import median
from typing import Annotated

import numpy as np
import typer

from xmarl_baselines.independent_ppo import CONTROLS
from xmarl_baselines.paper_lambda import RECORDS
from xmarl_baselines.policies import shipped_policies
from xmarl_baselines.reference import AIMS, EPISODES
from xmarl_bench.cli.program import run_function
from xmarl_bench.cli.score_table import performance_rows
from xmarl_bench.cli.tables import Row, markdown
from xmarl_bench.papers.kailas2025.paper import MAIN as PAPER
from xmarl_bench.parallel.workers import Workers
from xmarl_bench.policy import PolicyCard, load_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.default_policies import default_policies, is_checkpoint, selection_key
from xmarl_bench.records.files import write_json
from xmarl_bench.records.markdown import rewrite, with_part
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.evaluation import Performance, evaluate

ROOT = Path(__file__).parent.parent.parent
READMES = (ROOT / "README.md", ROOT / "baselines" / "README.md")
PICTURE = ROOT / "docs" / "learning.png"
ZERO_SHOT = Path(__file__).parent / "zero_shot.json"

MEASURES = {
    "success": "success_rate",
    "no agent collision": "no_agent_collision",
    "no wall contact": "no_object_collision",
    "makespan": "makespan",
}


def shown(measure: str, value: float | None) -> str:
    """A value as the tables show it."""
    return "-" if value is None else f"{value:.{0 if measure == 'makespan' else 2}f}"


def shipped_cards() -> list[PolicyCard]:
    return [load_card(folder) for folder in shipped_policies().values()]


def final(cards: list[PolicyCard]) -> list[PolicyCard]:
    """Without the checkpoints along training."""
    return [card for card in cards if not is_checkpoint(card)]


def cell_rows(cards: list[PolicyCard]) -> list[Row]:
    """One row per task, family, team size, with or without the term: best and median seed, aim, paper."""
    cells: defaultdict[tuple[str, str, int, bool], list[PolicyCard]] = defaultdict(list)
    for card in final(cards):
        cells[card.task, card.family or "", card.n_agents, card.attention_entropy > 0].append(card)
    rows: list[Row] = []
    for (task, family, n_agents, regularised), group in sorted(cells.items()):
        best = max(group, key=lambda card: selection_key(task, card.training["validation"]))
        row: Row = {"task": task, "family": family or "-", "agents": n_agents}
        row |= {"lambda": best.attention_entropy, "seeds": len(group)}
        for title, name in MEASURES.items():
            theirs = PAPER[task, n_agents].get(name)
            values = [card.performance["with_messages"][name] for card in group]
            mine = best.performance["with_messages"][name]
            row[title] = shown(name, mine)
            if mine is not None:
                paper = "" if theirs is None else f", paper {shown(name, theirs[regularised].mean)}"
                row[title] += f" ({shown(name, median(values))}){paper}"
            if name == "success_rate":
                row["aimed at"] = aimed_at(task, family, n_agents, regularised)
        unheard = best.performance["without_messages"]
        row["success without messages"] = shown("success_rate", unheard["success_rate"])
        row["attention entropy"] = f"{best.performance['attention_entropy']:.2f}"
        row["best seed"] = best.name
        rows.append(row)
    return rows


def aimed_at(task: str, family: str, n_agents: int, regularised: bool) -> str:
    """The success that the cell aims at: of the best seed, in brackets of the median."""
    if family == "residual":
        return "{:.2f} ({:.2f})".format(*(aim - 0.03 * regularised for aim in AIMS[task, n_agents]))
    if family == "paper" and task != "blind_navigation_v0":  # whose agents wait for one another for ever
        return f"{PAPER[task, n_agents]['success_rate'][regularised].mean - 0.05:.2f}"
    return "-"


def measured_rows(cards: list[PolicyCard]) -> list[Row]:
    return performance_rows(cards, [Performance(**card.performance) for card in cards])


def policy_rows(cards: list[PolicyCard]) -> list[Row]:
    rows = measured_rows(cards)
    for row, card in zip(rows, cards, strict=True):
        along = is_checkpoint(card)  # the time of its run is not its own
        frames = card.training["validation"]["frames"] if along else card.training["frames"]
        row["frames (M)"] = f"{frames / 1e6:.1f}"
        seconds = None if along else card.training.get("cpu_seconds")
        row["CPU minutes"] = "-" if seconds is None else f"{seconds / 60:.0f}"
        row["weights (sha256)"] = card.weights_sha256[:12]
    return rows


def control_rows() -> list[Row]:
    rows: list[Row] = []
    for path in sorted(CONTROLS.glob("*.json")):
        record = json.loads(path.read_bytes())
        heard = record["performance"]["with_messages"]
        row: Row = {"control": record["name"]}
        row |= {title: shown(name, heard[name]) for title, name in MEASURES.items()}
        rows.append(
            {**row, "frames (M)": f"{record['frames'] / 1e6:.1f}", "command": f"`{record['command']}`"}
        )
    return rows


def lambda_rows() -> list[Row]:
    """One row per run of the paper's schedule: its attention and what the team achieves."""
    rows: list[Row] = []
    records = [json.loads(path.read_bytes()) for path in RECORDS.glob("*.json")]
    for record in sorted(records, key=lambda r: (r["task"], -r["lambda"], r["name"])):
        start, end = record["along"][0], record["listening"]
        heard, unheard = (record["performance"][f"with{how}_messages"] for how in ("", "out"))
        entropy = record["performance"]["attention_entropy"]
        both = {
            title: f"{shown(MEASURES[title], heard[MEASURES[title]])}"
            f" / {shown(MEASURES[title], unheard[MEASURES[title]])}"
            for title in ("success", "no agent collision")
        }
        rows.append(
            {
                "task": record["task"],
                "lambda": record["lambda"],
                "advantages": "normalised" if record["normalize_advantage"] else "raw",
                "frames (M)": f"{record['frames'] / 1e6:.2f} of {record['frames_of_the_schedule'] / 1e6:.1f}",
                "attention entropy": f"{start['attention_entropy']:.2f} -> {entropy:.3f}",
                "own edge": f"{start['own_share']:.2f} -> {end['own_share']:.2f}",
                "most heard": f"{end['most_heard']:.2f}",
                **both,
                "episodes": record["performance"]["episodes"],
                "communication dependence": f"{end['communication_dependence']:.4f}",
                "command": f"`{record['command']}`",
            }
        )
    return rows


def measure_zero_shot() -> None:
    """Measure every navigation policy with 1, 2 and 3 agents more than in training, into ZERO_SHOT."""
    chosen = [card for card in final(shipped_cards()) if card.task == "blind_navigation_v0"]
    pairs = [
        (load_policy(shipped_policies()[card.name])[0], Cell(card.task, card.n_agents + more))
        for card in chosen
        for more in (1, 2, 3)
    ]
    performances = evaluate(pairs, Sampling(episodes=EPISODES), workers=Workers(2), progress=True)
    names = [card.name for card in chosen for _ in (1, 2, 3)]
    write_json(
        ZERO_SHOT,
        [{"policy": name, **each.record()} for name, each in zip(names, performances, strict=True)],
    )


def zero_shot_rows() -> list[Row]:
    if not ZERO_SHOT.exists():
        return []
    rows: list[Row] = []
    for record in json.loads(ZERO_SHOT.read_bytes()):
        heard = record["with_messages"]
        titles = ("success", "no agent collision", "makespan")
        measures = {title: shown(MEASURES[title], heard[MEASURES[title]]) for title in titles}
        rows.append({"policy": record["policy"], "tested with": record["n_agents"], **measures})
    return rows


@cache
def tables() -> dict[str, str]:
    """The tables of the READMEs, by the name in the markers around them."""
    cards = shipped_cards()
    return {
        "defaults": markdown(measured_rows(default_policies(cards))),
        "cells": markdown(cell_rows(cards)),
        "policies": markdown(policy_rows(cards)),
        "controls": markdown(control_rows()),
        "paper-lambda": markdown(lambda_rows()),
        "zero-shot": markdown(zero_shot_rows()),
    }


def filled(text: str) -> str:
    """A README with its tables brought up to date."""
    for name, table in tables().items():
        if f"<!-- {name}:begin -->" in text:
            text = with_part(text, name, f"{table}\n")
    return text


CURVES = {
    "success_rate": "success rate",
    "no_agent_collision": "episodes without\nagent collision (share)",
}
COLOURS = {3: "#0072b2", 4: "#d55e00", 5: "#009e73"}  # by team size


def draw(path: Path) -> None:
    """Draw the validation episodes along training: a column per task, a row per family and measure."""
    import matplotlib  # in the `dev` extra

    matplotlib.use("Agg")
    from matplotlib import pyplot

    cards = [card for card in final(shipped_cards()) if card.training.get("curve")]
    tasks = sorted({card.task for card in cards})
    rows = [(family, name) for family in sorted({card.family or "" for card in cards}) for name in CURVES]
    figure, panels = pyplot.subplots(
        len(rows), len(tasks), figsize=(11, 0.5 + 2.5 * len(rows)), sharex="col", sharey=True, squeeze=False
    )
    for (row, column), panel in np.ndenumerate(panels):
        family, name = rows[row]
        for card in cards:
            if (card.task, card.family or "") != (tasks[column], family):
                continue
            curve, regularised = card.training["curve"], card.attention_entropy > 0
            panel.plot(
                [record["frames"] / 1e6 for record in curve], [record[name] for record in curve],
                "--" if regularised else "-", color=COLOURS[card.n_agents], linewidth=1.2,
                label=f"{card.n_agents} agents" + (", attention-entropy term" if regularised else ""),
            )  # fmt: skip
        panel.set_ylim(-0.02, 1.02)
        panel.grid(alpha=0.25)
    for panel, task in zip(panels[0], tasks, strict=True):
        panel.set_title(task)
    for panel in panels[-1]:
        panel.set_xlabel("training so far (million steps of a team)")
    for panel, (family, name) in zip(panels[:, 0], rows, strict=True):
        panel.set_ylabel(f"{family} network\n{CURVES[name]}" if family else CURVES[name], fontsize=9)
    named = [panel.get_legend_handles_labels() for panel in panels.flat]
    labels = {label: handle for both in named for handle, label in zip(*both, strict=True)}
    unique = dict(sorted(labels.items()))
    figure.suptitle("How the shipped policies learned: validation episodes, with messages between agents")
    figure.legend(unique.values(), unique.keys(), loc="lower center", ncols=3, frameon=False)
    figure.tight_layout(rect=(0, 0.2 / len(rows), 1, 1))
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def main(
    zero_shot: Annotated[bool, typer.Option("--zero-shot", help="measure larger teams again")] = False,
) -> None:
    """Write the tables of the READMEs and the picture of the learning curves."""
    if zero_shot:
        measure_zero_shot()
    for readme in READMES:
        rewrite(readme, filled)
    draw(PICTURE)


if __name__ == "__main__":
    run_function(main)
