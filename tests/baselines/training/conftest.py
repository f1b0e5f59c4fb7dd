"""Short validation for every test of the trainer."""

from __future__ import annotations

import pytest
from xmarl_baselines.training import model_selection

from xmarl_bench.rollout.cell import Sampling


@pytest.fixture(autouse=True)
def short_validation(monkeypatch: pytest.MonkeyPatch) -> None:
    short = Sampling(episodes=2, max_cycles=10, seed=model_selection.VALIDATION.seed)
    monkeypatch.setattr(model_selection, "VALIDATION", short)
