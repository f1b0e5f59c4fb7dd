"""Measures the table of docs/metrics.md and draws docs/metrics.png.

    .venv/bin/python docs/make_metrics.py

For the default policy of each cell, on every timestep of its first 10 scoring episodes. Random rankings have
fixed seeds, so the same policies give the same table.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from torch import Tensor
from xmarl_baselines.explainers.attention import attention_mask
from xmarl_baselines.explainers.attention_rowmax import attention_rowmax_mask
from xmarl_envs import TASKS, make_task

from xmarl_bench.explain.controls import ones_mask, random_mask, self_mask
from xmarl_bench.explain.explainer import Explain
from xmarl_bench.metrics import table as table_of_metrics
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.policy import Policy, load_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.default_policies import default_policies
from xmarl_bench.records.markdown import markdown_table, rewrite, with_part
from xmarl_bench.reproducible import episode_seeds, one_thread
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import roll_out
from xmarl_bench.rollout.reference_states import reference_states
from xmarl_bench.scoring.states import States

HERE = Path(__file__).parent
EPISODES = 10
METRICS = ("fid_delta", "budgeted_fidelity", "message_fidelity", "mask_mass")


def squeezed_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """The random mask with its values mapped to [0.9, 1]: the same ranking."""
    return 0.9 + 0.1 * random_mask(policy, observations, generator)


MASKS: dict[str, Explain] = {
    "random": random_mask,
    "random in [0.9, 1]": squeezed_mask,
    "all ones": ones_mask,
    "self edge only": self_mask,
    "attention": attention_mask,
    "attention / row max": attention_rowmax_mask,
}
Row = dict[str, float]


def measure(folder: Path) -> tuple[str, dict[str, Row]]:
    """A policy's task, and for each mask, the oracle last, its metrics averaged over episodes."""
    policy, card = load_policy(folder)
    rows: dict[str, list[list[float | None]]] = defaultdict(list)
    with one_thread():
        seeds = episode_seeds(0, EPISODES)
        reference = reference_states(policy, Cell(card.task, card.n_agents))
        for episode in roll_out(make_task(card.task, card.n_agents), policy, seeds):
            observations = torch.tensor(episode.observations)
            states = States.of(policy, observations, np.random.default_rng(episode.seed), reference)
            assert states.oracle_mask is not None
            masks = {
                name: explain(policy, observations, torch.Generator().manual_seed(episode.seed))
                for name, explain in MASKS.items()
            }
            for name, mask in {**masks, "oracle (binary)": states.oracle_mask}.items():
                values = states.mask_metrics(mask)
                rows[name].append([getattr(values, metric) for metric in METRICS])
    means = {
        name: np.nanmean(np.array(each, dtype=np.float64), axis=0).tolist() for name, each in rows.items()
    }
    return card.task, {name: dict(zip(METRICS, each, strict=True)) for name, each in means.items()}


def table(measured: dict[str, list[dict[str, Row]]]) -> str:
    """A Markdown table of means over policies, a row per task and mask."""
    rows = []
    for task, policies in measured.items():
        for name in policies[0]:
            means = [np.mean([policy[name][metric] for policy in policies]) for metric in METRICS]
            rows.append((task, name, *(f"{mean:.3f}" for mean in means)))
    return markdown_table(("task", "mask", *map(heading, METRICS)), rows)


def draw(measured: dict[str, list[dict[str, Row]]], path: Path) -> None:
    """Draw a column per task: FidDelta as a share of the oracle's above, budgeted fidelity below."""
    figure, axes = plt.subplots(2, len(measured), figsize=(11, 6.2), sharey=True, layout="constrained")
    for column, (task, policies) in zip(axes.T, measured.items(), strict=True):
        names = list(MASKS)
        above = [
            [p[name]["fid_delta"] / p["oracle (binary)"]["fid_delta"] for name in names] for p in policies
        ]
        _bars(column[0], names, above, "#b0563b", 0.0, 0.62)
        column[0].set_title(task, fontsize=11)
        column[0].set_xlabel("FidDelta, share of the best binary mask's")
        column[0].axvline(1.0, color="0.4", linewidth=0.8)
        for metric, colour, offset in (
            ("budgeted_fidelity", "#8fb3d0", -0.17),
            ("message_fidelity", "#1f5d93", 0.17),
        ):
            _bars(
                column[1],
                names,
                [[p[name][metric] for name in names] for p in policies],
                colour,
                offset,
                0.32,
            )
        column[1].set_xlabel("budgeted fidelity: 0 random, 1 best ranking")
        for limit in (0.0, 1.0):
            column[1].axvline(limit, color="0.4", linewidth=0.8)
    handles = [Patch(color=colour) for colour in ("#8fb3d0", "#1f5d93")]
    names = ["all edges", "messages, mean of four absence models"]
    axes[1, -1].legend(handles, names, fontsize=8, loc="upper right")
    axes[0, 0].invert_yaxis()
    figure.savefig(path, dpi=130)


def _bars(
    axis: Axes, names: list[str], values: list[list[float]], colour: str, offset: float, height: float
) -> None:
    at = np.arange(len(names)) + offset
    axis.barh(at, np.mean(values, axis=0), height=height, color=colour)
    for policy in values:
        axis.plot(policy, at, ".", color="black", markersize=4)
    axis.set_yticks(range(len(names)), names)


def heading(name: str) -> str:
    metric = table_of_metrics.by_name()[name]
    return metric.heading or metric.title


def main() -> None:
    measured: dict[str, list[dict[str, Row]]] = {task: [] for task in TASKS}
    folders = find_policies()
    for best in default_policies(load_card(folder) for folder in folders.values()):
        task, means = measure(folders[best.name])
        measured[task].append(means)
    draw(measured, HERE / "metrics.png")
    rewrite(HERE / "metrics.md", lambda text: with_part(text, "measured", table(measured)))


if __name__ == "__main__":
    main()
