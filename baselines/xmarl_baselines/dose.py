"""Measures the runs of a dose: what the weight of the attention-entropy term does to attention.

    xmarl-train --reproduce dose --jobs 2 --out runs
    python -m xmarl_baselines.dose runs

writes baselines/xmarl_baselines/controls/dose/NAME.json for each finished run without one; docs/make_dose.py
makes the page from these files.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from xmarl_baselines.independent_ppo import CONTROLS
from xmarl_baselines.reference import dose_runs, finished_bundle
from xmarl_bench import score
from xmarl_bench.cli.program import run_function
from xmarl_bench.policy import load_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.records.files import write_json

RECORDS = CONTROLS / "dose"
FIDELITY = "message_fidelity", "smallest_message_fidelity"
COMPARED = "nearest", "initial-attention"  # controls


def measured(bundle: Path) -> dict[str, Any]:
    """How well attention explains a policy, how controls do, and how the policy does its task."""
    policy, card = load_policy(bundle)
    (cell,) = score((policy, card), "attention", behaviour_episodes=0).results
    played = card.performance["with_messages"]
    controls = {name: cell.controls[name] for name in COMPARED if name in cell.controls}
    return {
        "name": card.name,
        "command": card.training["command"],
        "weights_sha256": card.weights_sha256,
        "lambda": card.attention_entropy,
        "seed": card.training_seed,
        "success": played["success_rate"],
        "no_agent_collision": played["no_agent_collision"],
        "success_without_messages": card.performance["without_messages"]["success_rate"],
        "attention_entropy": card.performance["attention_entropy"],
        **{metric: getattr(cell.metrics, metric).value for metric in FIDELITY},
        "controls": {
            name: {metric: getattr(each, metric).value for metric in FIDELITY}
            for name, each in controls.items()
        },
    }


def main(
    runs: Annotated[Path, typer.Argument(help="folder that `xmarl-train --out` wrote to")],
    out: Annotated[Path, typer.Option(help="folder for NAME.json")] = RECORDS,
) -> None:
    """Measure the finished runs of the dose that have no file, or one of other weights.

    Raises InputError if a run there has another run's name.
    """
    for name, run in dose_runs().items():
        bundle, path = finished_bundle(run, runs), out / f"{name}.json"
        if bundle is None:
            continue
        if (
            path.exists()
            and json.loads(path.read_bytes())["weights_sha256"] == load_card(bundle).weights_sha256
        ):
            continue
        record = measured(bundle)
        write_json(path, record)
        print(f"{path}: message fidelity of attention {record['message_fidelity']:.2f}")


if __name__ == "__main__":
    run_function(main)
