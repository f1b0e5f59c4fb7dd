"""Conformance tests for tasks, yours included.

Call `check_task(MyTask)` in a test. It plays some thousand steps in a few seconds, and raises an
AssertionError that names the first broken promise and how it was broken.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import cloudpickle
import numpy as np
from pettingzoo import ParallelEnv

from xmarl_envs.actions import random_actions
from xmarl_envs.constructors import make_constructors
from xmarl_envs.pettingzoo_checks import Make, check_pettingzoo, promise
from xmarl_envs.task import Task
from xmarl_envs.trajectory import Pushes, play, play_env, play_task
from xmarl_envs.vector_env import VectorEnv

MAX_STEPS = 1000  # of an episode that does not end by itself
SIZES = (1, 2, 3, 4, 5, 8, 16, 32, 64)
HASH_SEEDS = ("0", "12345")
EXTREMES = (1.0, 1e3, 1e6)  # m/s and m


def check_task(task: type[Task] | Callable[..., Any], *, seed: int = 0, **options: Any) -> None:
    """Raise an AssertionError that names the first promise which the task breaks.

    Args:
        task: a `Task` class, or a constructor of a PettingZoo ParallelEnv that takes `max_cycles` and, if its
            metadata lists render modes, `render_mode`.
        seed: of the episodes that are played.
        options: passed to the task or constructor, e.g. `n_agents=5`.

    Checked for every environment:
    - it passes PettingZoo's tests of the parallel API, the turn-by-turn (AEC) API, seeds, `max_cycles`,
      `state()` and rendering without a warning (except that spaces are unbounded);
    - its spaces contain every observation, also at full thrust;
    - episodes of different seeds differ;
    - one seed with the same actions gives the same bits, whatever was played before, is played beside it or
      is drawn, and in other processes with other hash seeds.

    Checked for a Task class too:
    - no agent observes another;
    - observations are finite and in their space at any speed and place;
    - an episode does not depend on the others of its batch;
    - every team size from 1 to `max_agents` (tried up to 64) plays, and those just outside are refused.
    """
    with _quiet_and_without_screen():
        if isinstance(task, type) and issubclass(task, Task):
            with promise(task.__name__, "it has a `name`"):
                assert isinstance(getattr(task, "name", None), str), "it has none"
            make: Make = partial(make_constructors(task).parallel_env, **options)
            rules = task(**options)
            _check_team_sizes(task, seed, **options)
            _check_observations(rules, make, seed)
            _check_environment(task.name, make, partial(play_task, rules, seed), seed)
            _check_batches(rules, seed)
        else:
            make = partial(task, **options)
            name = getattr(task, "__qualname__", repr(task))
            _check_environment(name, make, partial(_play_new, make, seed), seed)


def _check_environment(name: str, make: Make, episode: Callable[[], str], seed: int) -> None:
    """Check the promises of any ParallelEnv. episode: returns an episode's hash, also in other processes."""
    with promise(name, "it can be made and is a PettingZoo ParallelEnv"):
        env = make()
        assert isinstance(env, ParallelEnv), f"it is a {type(env).__name__}"
        name = env.metadata.get("name", name)
    check_pettingzoo(name, make, bool(env.metadata.get("render_modes")), seed)
    for at_bounds in (False, True):
        with promise(name, "its spaces contain every observation"):
            _check_contained(make(), seed, at_bounds)
    with promise(name, "another seed gives another episode"):
        starts = {play_env(make(), seed + k, max_steps=5) for k in range(4)}
        assert len(starts) == 4, f"four seeds gave {len(starts)}"
    alone = play_env(make(), seed, MAX_STEPS)
    same = "the same seed and actions give the same episode"
    with promise(name, f"{same} whatever was played before"):
        env = make()
        for k in (1, 2, 0):
            used = play_env(env, seed + k, MAX_STEPS)
        assert used == alone, "it differs after two other episodes in the same environment"
    with promise(name, f"{same} whatever is played beside it"):
        other = make()
        others_pushes = Pushes(other, seed + 1)

        def step_the_other() -> None:
            if not getattr(other, "agents", []):  # some environments have no agents before the first reset
                other.reset(seed=seed + 1)
            other.step(others_pushes.next(other.agents))

        assert play_env(make(), seed, MAX_STEPS, step_the_other) == alone, (
            "it differs while a second environment is stepped in turn with it"
        )
    if "rgb_array" in env.metadata.get("render_modes", ()):
        with promise(name, f"{same} whether it is drawn or not"):
            drawn, steps = make(render_mode="rgb_array"), itertools.count()
            assert play_env(drawn, seed, MAX_STEPS, lambda: next(steps) % 20 or drawn.render()) == alone, (
                "it differs when it is rendered"
            )
            drawn.close()
    here = episode()
    for hash_seed in HASH_SEEDS:
        with promise(name, f"{same} in every process"):
            assert _in_another_process(episode, hash_seed) == here, (
                f"it differs in a process with PYTHONHASHSEED={hash_seed}"
            )


def _check_contained(env: Any, seed: int, at_bounds: bool) -> None:
    """Check every observation and reward of an episode under random pushes, or at full thrust."""
    pushes = Pushes(env, seed, at_bounds)
    observations, _ = env.reset(seed=seed)
    for cycle in range(MAX_STEPS):
        for agent, observation in observations.items():
            _assert_contained(env, agent, observation, f"after {cycle} cycles")
        if not env.agents:
            break
        observations, rewards, *_ = env.step(pushes.next(env.agents))
        for agent, reward in rewards.items():
            assert np.isfinite(reward), f"the reward of {agent} in cycle {cycle + 1} is {reward}"


def _assert_contained(env: Any, agent: Any, observation: Any, when: str) -> None:
    space = env.observation_space(agent)
    assert space.contains(observation), f"that of {agent} {when} is not in {space}"
    finite = not isinstance(observation, np.ndarray) or np.isfinite(observation).all()
    assert finite, f"that of {agent} {when} is not finite"


def _check_observations(task: Task, make: Make, seed: int) -> None:
    """Check the observations of a Task by moving the agents of an episode by hand."""
    name = task.name
    rng = np.random.default_rng(seed)
    with promise(name, "no agent observes another"):
        env = VectorEnv(task)
        for trial in range(10):
            env.reset([seed + trial])
            env.step(random_actions(task, 1, rng))
            for mover in range(task.n_agents):
                before = env.observe()[0]
                env.world.position[0, mover] = rng.uniform(-3, 3, 2)
                env.world.velocity[0, mover] = rng.uniform(-3, 3, 2)
                seen = np.flatnonzero((env.observe()[0] != before).any(axis=-1))
                witnesses = [int(i) for i in seen if i != mover]
                assert not witnesses, f"moving agent {mover} changed what agents {witnesses} observe"
    with promise(name, "its spaces contain every observation at any speed and place"):
        shell = make()
        env.reset([seed])
        for extreme in EXTREMES:
            env.world.velocity[0] = rng.uniform(-extreme, extreme, (task.n_agents, 2))
            env.world.position[0] = rng.uniform(-extreme, extreme, (task.n_agents, 2))
            for agent, observation in zip(shell.possible_agents, env.observe()[0], strict=True):
                _assert_contained(shell, agent, observation, f"at {extreme:g} m/s")


def _check_batches(task: Task, seed: int) -> None:
    with promise(task.name, "an episode does not depend on its neighbours in a batch"):
        alone = play_task(task, seed)
        for n_episodes, slot in ((2, 1), (5, 0), (5, 3)):
            env = VectorEnv(task, n_episodes)
            for meddling in (False, True):
                assert play(env, seed, slot, meddling)[0] == alone, (
                    f"episode {slot} of {n_episodes} differs from the same episode alone"
                    + (" while the others begin anew and drop out" if meddling else "")
                )


def _check_team_sizes(task: type[Task], seed: int, **options: Any) -> None:
    options.pop("n_agents", None)
    make = make_constructors(task).parallel_env
    for n_agents in sorted({*(n for n in SIZES if n < task.max_agents), min(task.max_agents, SIZES[-1])}):
        with promise(task.name, f"it plays with any team of 1 to {task.max_agents}"):
            env = make(n_agents=n_agents, max_cycles=3, **options)
            assert len(env.possible_agents) == n_agents, f"{n_agents} make a team of {env.possible_agents}"
            _check_contained(env, seed, at_bounds=True)
    for n_agents in (0, task.max_agents + 1):
        with promise(task.name, f"it refuses a team of {n_agents}, saying so in a ValueError"):
            try:
                make(n_agents=n_agents, **options)
            except ValueError as refusal:
                assert str(n_agents) in str(refusal), f"the error only says {str(refusal)!r}"
            else:
                raise AssertionError("the team was made")


def _play_new(make: Make, seed: int) -> str:
    return play_env(make(), seed, MAX_STEPS)


def _in_another_process(episode: Callable[[], str], hash_seed: str) -> str:
    """The result of `episode` in a new Python process with this PYTHONHASHSEED."""
    code = "import pickle, sys; print(); print(pickle.load(sys.stdin.buffer)())"
    path = os.pathsep.join(folder or str(Path.cwd()) for folder in sys.path)
    run = subprocess.run(
        [sys.executable, "-c", code],
        input=cloudpickle.dumps(episode),
        env={**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": path},
        capture_output=True,
        check=False,
    )
    said = run.stderr.decode().strip().splitlines() or [f"exit code {run.returncode}"]
    assert run.returncode == 0, f"there it fails with {said[-1]}"
    return str(run.stdout.decode().splitlines()[-1])


@contextlib.contextmanager
def _quiet_and_without_screen() -> Iterator[None]:
    """Silence PettingZoo's tests, and open no pygame windows unless a video driver is set."""
    with mock.patch.dict(os.environ), contextlib.redirect_stdout(io.StringIO()):
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
        yield
