"""A fixture for examples of documents, which play episodes of the tasks' own length."""

from __future__ import annotations

import pytest
from xmarl_envs import TASKS


@pytest.fixture
def short_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    for task in TASKS.values():
        monkeypatch.setattr(task, "default_max_cycles", 40)
