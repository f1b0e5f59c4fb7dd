"""`check task` passes sound tasks, and finds what five steps do not show."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.bench.tasks import worlds
from tests.conftest import RunCli
from xmarl_bench.checks.task_checks import check_task
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.tasks import sources
from xmarl_bench.tasks.sources import open_task

SHARED = np.random.default_rng(0)


class LateNoise(worlds.Line):
    """Draws from one generator for all environments, but only in its last step."""

    def step(self, actions: Any) -> Any:
        if self.cycle == 5:
            self.place = self.place + SHARED.uniform(size=self.place.shape)
        return super().step(actions)


class Alike(worlds.Line):
    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        return super().reset(7)


class Infinite(worlds.Line):
    def step(self, actions: Any) -> Any:
        seen, rewards, *rest = super().step(actions)
        return seen, dict.fromkeys(rewards, np.inf), *rest


class Undefined(worlds.Line):
    def step(self, actions: Any) -> Any:
        seen, rewards, *rest = super().step(actions)
        return seen, dict.fromkeys(rewards, np.nan), *rest


def late_noise(n_agents: int) -> LateNoise:
    return LateNoise(n_agents)


def alike(n_agents: int) -> Alike:
    return Alike(n_agents)


def infinite(n_agents: int) -> Infinite:
    return Infinite(n_agents)


def undefined(n_agents: int) -> Undefined:
    return Undefined(n_agents)


@pytest.fixture(autouse=True)
def nothing_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "_opened", {})


@pytest.mark.parametrize(
    ("factory", "check"),
    [
        (late_noise, "episodes repeat"),
        (alike, "seeds differ"),
        (infinite, "finite rewards"),
        (undefined, "finite rewards"),
    ],
)
def test_faults_are_found(factory: Callable[[int], Any], check: str) -> None:
    cell = Cell(open_task(factory).name, 3)
    failed = [finding.check for finding in check_task(cell) if finding.passed is False]
    assert failed == [check]


def test_a_sound_task_passes(run_cli: RunCli) -> None:
    ran = run_cli("check", "task", "tests.bench.tasks.worlds:told", "--trust-code", "--json")
    assert ran.code == 0, ran.err
    findings = {each["check"]: each for each in json.loads(ran.out)["findings"]}
    assert findings["success"]["said"] == "0.67 by random actions"
    assert findings["episodes end"]["said"] == "6 to 6 steps, at most 6"
    assert findings["spaces"]["said"] == "3 agents, 2 entries of an observation, 2 entries of an action"


def test_what_infos_do_not_tell_is_not_applicable_and_ours_pass() -> None:
    untold = {
        finding.check
        for finding in check_task(Cell(open_task(worlds.line).name, 3))
        if finding.passed is None
    }
    assert untold == {"success", "no agent collision", "no object collision"}
    assert all(finding.passed for finding in check_task(Cell("blind_discovery_v0", 3), episodes=2))


def test_what_only_some_episodes_tell_is_a_fault() -> None:
    cell = Cell(open_task(worlds.happened).name, 3)
    failed = {finding.check: finding.message for finding in check_task(cell) if finding.passed is False}
    assert failed.keys() == {"success", "no agent collision"}
    assert re.match(r"told in [1-4] of 5 episodes, .* tell it in every episode", failed["success"])


def test_it_needs_trust(run_cli: RunCli) -> None:
    ran = run_cli("check", "task", "tests.bench.tasks.worlds:told")
    assert ran.code == 2
    assert "--trust-code" in ran.err
