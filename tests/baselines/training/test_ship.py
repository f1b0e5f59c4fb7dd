"""`ship` copies finished runs, and checkpoints along the training of navigation, N = 3, seed 0."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from xmarl_baselines import ship
from xmarl_baselines.training.command import train_and_save
from xmarl_baselines.training.families import FAMILIES
from xmarl_baselines.training.trainer import Run

from tests.baselines.training.small_runs import small
from xmarl_bench.policy import initial_policy, load_policy
from xmarl_bench.policy.card import load_card


@pytest.mark.usefixtures("short_episodes")
def test_checkpoints_of_both_families_and_both_lambdas(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run of ten iterations that validates after each, at 10, 20, ... 100 percent."""
    short: dict[str, Any] = {"frames": 400, "n_envs": 2, "n_steps": 20, "batch_size": 40, "n_epochs": 1}
    runs = [
        Run(small(**short, family=family), attention_entropy=weight)
        for family, weight in zip(FAMILIES, (0.0, 0.1), strict=True)
    ]
    others = [Run(small(**short), seed=1), Run(small("blind_discovery_v0", **short))]
    unfinished = Run(small(**short), 5)
    for run in runs + others:
        train_and_save(run, tmp_path / "runs" / run.name, resume=False, start_from=None, episodes=1)
    named = {run.name: run for run in [*runs, *others, unfinished]}
    package = tmp_path / "policies"
    monkeypatch.setattr(ship, "HERE", package)
    monkeypatch.setattr(ship, "EPISODES", 1)
    monkeypatch.setattr(ship, "reference_runs", lambda: named)
    ship.main(tmp_path / "runs")
    moments = {f"{run.name}-at{percent}" for run in runs for percent in (10, 20, 50, 80, 90)}
    assert {folder.name for folder in package.iterdir()} == moments | {run.name for run in runs + others}
    for name in moments:
        run_name, percent = name.rsplit("-at", 1)
        policy, card = load_policy(package / name)
        finished = load_card(package / run_name)
        assert card.training["percent"] == int(percent)
        assert card.training["validation"]["frames"] == 4 * int(percent)
        assert card.training["command"].endswith(f"validated/{4 * int(percent):010d}.safetensors")
        assert card.family == finished.family == named[run_name].recipe.family
        assert card.initial_seed == 0
        before = initial_policy(card)
        assert not torch.equal(
            policy.state_dict()["decoder.0.weight"], before.state_dict()["decoder.0.weight"]
        )
    longer = Run(small(**short | {"frames": 800}), seed=1)  # of the same name as a run that is there
    monkeypatch.setattr(ship, "HERE", tmp_path / "other")
    monkeypatch.setattr(ship, "reference_runs", lambda: {longer.name: longer})
    ship.main(tmp_path / "runs")
    assert "not shipped: " in capsys.readouterr().out
    assert not (tmp_path / "other").exists()
