"""A task of others steps its episodes in a process of its own, to the bit, and does no harm there."""

from __future__ import annotations

import os
import re
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from torch_geometric.nn import GATv2Conv
from xmarl_envs import Step

from tests.bench.tasks import worlds
from tests.conftest import MakeBundle, RunCli
from tests.helpers.policies import small_policy
from xmarl_bench import PolicyModule, save_policy, score
from xmarl_bench.entry.file import read_entries
from xmarl_bench.entry.schema import Entry
from xmarl_bench.errors import InputError
from xmarl_bench.isolation.conversation import Isolation, end_strangers
from xmarl_bench.isolation.tasks import AskedSource, ask_task
from xmarl_bench.policy import PolicyCard
from xmarl_bench.tasks import sources
from xmarl_bench.tasks.interface import random_actions

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="needs processes of Unix")]
HERE, WORLDS = "tests.bench.isolation.test_tasks", "tests.bench.tasks.worlds"


@pytest.fixture(autouse=True)
def end(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(sources, "_opened", {})
    yield
    end_strangers()


def liner() -> PolicyModule:
    return PolicyModule("liner", GATv2Conv(2, 4, add_self_loops=False), worlds.told, 3)


@pytest.mark.parametrize("factory", [worlds.spread, worlds.told, worlds.Farther])
def test_episodes_are_those_of_the_task_to_the_bit(factory: Callable[..., Any]) -> None:
    here = sources.open_task(factory)
    apart = ask_task(f"{WORLDS}:{factory.__name__}", Isolation(), trust_code=True)
    assert isinstance(apart, AskedSource)
    assert (apart.name, apart.origin) == (here.name, sources.open_task(here.name).origin)
    assert apart.observation_names == here.observation_names
    assert apart.environment(3) == here.environment(3)
    assert sources.known_task(here.name) is apart
    one, other = (each.make(3) for each in (here, apart))
    for name in (
        "name", "n_agents", "obs_dim", "observation_names", "continuous_actions", "action_width",
        "default_max_cycles", "has_objects",
    ):  # fmt: skip
        assert getattr(one, name) == getattr(other, name), name
    envs = [each.vector_env(4, 5) for each in (one, other)]
    rng, live = np.random.default_rng(0), np.array([True, True, False, True])
    for seeds, episodes in (([3, 1, 4, 1], None), ([9], [2])):
        began = [env.reset(seeds, episodes) for env in envs]
        assert np.array_equal(began[0], began[1])
    for _ in range(5):
        action = random_actions(one, 4, rng)
        steps = [env.step(action, live) for env in envs]
        for name in Step._fields:
            first, second = (np.asarray(getattr(step, name)) for step in steps)
            assert np.array_equal(first, second, equal_nan=True), name
            assert first.astype(second.dtype).tobytes() == second.tobytes()


def test_other_actions_are_of_the_task_too() -> None:
    told = ask_task(worlds.told, Isolation())
    with pytest.raises(InputError, match="task 'told' takes continuous actions and the policy chooses disc"):
        told.make(3).with_actions(False)
    farther = ask_task(worlds.Farther, Isolation()).make(3)
    discrete = farther.with_actions(False)
    assert (discrete.continuous_actions, discrete.action_width) == (False, 5)
    assert discrete.with_actions(True).action_width == farther.action_width
    with pytest.raises(InputError, match=r"farther_v0 takes 1 to \d+ agents, got 99"):
        ask_task(worlds.Farther, Isolation()).make(99)


def test_an_entry_on_a_task_of_others_has_the_same_values_in_one_process(tmp_path: Path) -> None:
    policy = small_policy(18, categorical=True)
    card = PolicyCard(
        name="spreader", task="spread", n_agents=3, attention_entropy=0.0, architecture=policy.architecture,
        weights_sha256="0" * 64,
    )  # fmt: skip
    quick: dict[str, Any] = {"task": worlds.spread, "episodes": 2, "timesteps": 2, "max_cycles": 4}
    entries = [score((policy, card), "occlusion", isolate=each, **quick) for each in (True, False)]
    assert entries[0].results == entries[1].results
    apart, here = ((each.protocol.tasks or {})["spread"] for each in entries)
    assert (apart.isolated, here.isolated) == (None, False)
    assert apart.model_copy(update={"isolated": False}) == here


def test_a_policy_that_is_code_brings_its_task(tmp_path: Path) -> None:
    quick: dict[str, Any] = {"episodes": 2, "timesteps": 2}
    asked = score(f"{HERE}:liner", "random", trust_code=True, **quick)
    assert isinstance(sources.known_task("told"), AskedSource)
    here = score(f"{HERE}:liner", "random", trust_code=True, isolate=False, **quick)
    assert asked.protocol.tasks is not None
    assert asked.protocol.tasks["told"].entry_point == f"{WORLDS}:told"
    assert asked.results[0].metrics.success_rate == here.results[0].metrics.success_rate


HOSTILE = """
import os, sys

from tests.bench.tasks.worlds import Line
import xmarl_bench.metrics as metrics

for name in list(vars(metrics)):
    if callable(getattr(metrics, name)) and name.islower():
        setattr(metrics, name, lambda *_, **__: 1.0)
os.chdir("/")
print("noise")

class Stop(BaseException):
    pass

class Breaks(Line):
    def step(self, actions):
        if self.cycle == 6:
            self.breaks()
        return super().step(actions)

class Crashing(Breaks):
    max_cycles = 9
    def breaks(self):
        os._exit(7)

class Stopping(Breaks):
    max_cycles = 9
    def breaks(self):
        raise Stop("now")

class Wrong(Line):
    def seen(self):
        found = super().seen()
        return found if self.cycle < 6 else {agent: each[:1] for agent, each in found.items()}
    max_cycles = 9

def crashing(n_agents):
    return Crashing(n_agents)

def stopping(n_agents):
    return Stopping(n_agents)

def wrong(n_agents):
    return Wrong(n_agents)
"""


def test_hostile_tasks_in_a_sweep_change_no_other_entry(
    make_bundle: MakeBundle, tmp_path: Path, run_cli: RunCli
) -> None:
    (tmp_path / "mine.py").write_text(HOSTILE)
    bundles = [make_bundle()]
    for name in ("Crashing", "Stopping", "Wrong"):
        task = name.lower()
        card: dict[str, Any] = {"task": task, "n_agents": 3, "attention_entropy": 0.0}
        save_policy(tmp_path / name, small_policy(2), name=f"on-{task}", **card)
        bundles.append(tmp_path / name)

    def scored(n: int) -> tuple[dict[str, Entry], int, str]:
        folder = tmp_path / f"out{n}"
        policies = [part for bundle in bundles[:n] for part in ("--policy", bundle)]
        tasks = [
            part
            for name in ("crashing", "stopping", "wrong")
            for part in ("--task", f"{tmp_path}/mine.py:{name}")
        ]
        more = [*tasks, "--task", "blind_navigation_v0", "--trust-code"] if n > 1 else []
        ran = run_cli(
            "score", *policies, *more, "--explainer", "occlusion", "--episodes", 3, "--timesteps", 3,
            "--behaviour-episodes", 0, "--max-cycles", 9, "--out", folder, "--cache", tmp_path / f"cache{n}",
        )  # fmt: skip
        return {each.policy.name: each for _, each in read_entries(folder / "entries")}, ran.code, ran.err

    alone, code_alone, _ = scored(1)
    beside, code_beside, errors = scored(4)
    assert (code_alone, code_beside) == (0, 1), errors
    assert beside.keys() == {"small"}
    assert alone["small"].entry_id == beside["small"].entry_id
    for said in (
        r"failed: occlusion on on-crashing: the process of task mine.py:crashing ended \(exit code 7\)",
        r"failed: occlusion on on-stopping: task mine.py:stopping failed \(Stop: now\): correct it",
        r"failed: occlusion on on-wrong: task 'wrong' gave agent_0 an observation with shape \(1,\)",
    ):
        assert re.search(said, errors), errors
    assert "noise" not in errors


def test_observations_that_are_no_numbers_are_refused() -> None:
    class Lost(worlds.Farther):
        name = "lost_v0"

        def observe(self, *args: Any, **kwargs: Any) -> Any:
            return super().observe(*args, **kwargs) * np.nan

    with pytest.raises(InputError, match="task Lost gave observations that are NaN or infinite"):
        ask_task(Lost, Isolation()).make(3).vector_env(1).reset([1])


def test_code_that_changes_during_a_run_is_refused(tmp_path: Path) -> None:
    file, code = tmp_path / "own.py", "from tests.bench.tasks.worlds import Line\nclass Own(Line): "
    code += "...\ndef own(n_agents): return Own(n_agents)\n"
    file.write_text(code)
    task = ask_task(f"{file}:own", Isolation(), trust_code=True).make(3)
    task.vector_env(1).reset([1])
    end_strangers()  # a worker process starts its own
    file.write_text(code + "# more")
    with pytest.raises(InputError, match=r"the code of task own.py:own has changed since it was loaded"):
        task.vector_env(1).reset([1])


def test_environments_that_nobody_plays_any_more_are_released() -> None:
    task = ask_task(counting, Isolation()).make(3)
    alive = [int(task.vector_env(4).reset([0, 1, 2, 3])[3, 0, 0]) for _ in range(4)]
    assert alive == [4] * 4


class Counting(worlds.Line):
    """Observations are the number of such environments in the process, beside the step."""

    alive: ClassVar[Any] = weakref.WeakSet()

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        _, infos = super().reset(seed, options)
        self.alive.add(self)
        self.place = np.full(len(self.agents), len(self.alive))
        return self.seen(), infos


def counting(n_agents: int) -> Counting:
    return Counting(n_agents)
