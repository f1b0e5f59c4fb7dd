"""Copies finished runs into the package: policies/NAME, and for the study over training policies/NAME-atPP.

    python -m xmarl_baselines.ship RUNS

Copies the bundle of every reference run that `xmarl-train --reproduce` finished in the folder RUNS and that
the package does not hold yet. Every seed is shipped, the worst like the best.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from safetensors.torch import load_file

from xmarl_baselines.policies import HERE
from xmarl_baselines.reference import EPISODES, finished_bundle, reference_runs
from xmarl_baselines.training.model_selection import weights_at
from xmarl_bench.cli.program import run_function
from xmarl_bench.errors import InputError
from xmarl_bench.policy import GraphPolicy, load_policy, save_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.untrusted import CARD
from xmarl_bench.rollout.evaluation import evaluate_policy

# Percent of training. The appendix of Kailas et al. (ICML 2025) on training iterations has 20, 50 and 80 in
# its table, 10, 50 and 90 in its text. Every run validates at all of them.
ALONG_TRAINING = (10, 20, 50, 80, 90)


def main(runs: Annotated[Path, typer.Argument(help="folder that `xmarl-train --out` wrote to")]) -> None:
    """Copy finished reference runs into the package."""
    for name, run in reference_runs().items():
        try:
            bundle = finished_bundle(run, runs)
        except InputError as error:
            print(f"not shipped: {error}")
            continue
        if bundle is None:
            continue
        policy, card = load_policy(bundle)
        along = (run.recipe.task, run.n_agents, run.seed) == ("blind_navigation_v0", 3, 0)
        there = [name, *(f"{name}-at{percent}" for percent in ALONG_TRAINING if along)]
        if all((HERE / each / CARD).exists() for each in there) and load_card(HERE / name) == card:
            continue
        assert isinstance(policy, GraphPolicy)  # what xmarl-train trains
        fields = card.model_dump(exclude={"architecture", "weights_sha256"})
        save_policy(HERE / name, policy, **fields)
        print(f"{name}: success {card.performance['with_messages']['success_rate']:.3f}")
        if along:
            _ship_along_training(runs / name, policy, fields)


def _ship_along_training(run: Path, policy: GraphPolicy, fields: dict[str, Any]) -> None:
    """Save the weights of the validations nearest to ALONG_TRAINING as policies, each measured."""
    frames, curve = fields["training"]["frames"], fields["training"]["curve"]
    for percent in ALONG_TRAINING:
        validation = min(curve, key=lambda record: abs(record["frames"] - frames * percent / 100))
        weights = weights_at(run, validation)
        policy.load_state_dict(load_file(weights))
        training = {**fields["training"], "validation": validation, "percent": percent}
        training["command"] += f"; then {weights.relative_to(run.parent)}"
        save_policy(
            HERE / f"{fields['name']}-at{percent}",
            policy,
            **{
                **fields,
                "name": f"{fields['name']}-at{percent}",
                "training": training,
                "performance": evaluate_policy(policy, fields["task"], fields["n_agents"], episodes=EPISODES),
            },
        )


if __name__ == "__main__":
    run_function(main)
