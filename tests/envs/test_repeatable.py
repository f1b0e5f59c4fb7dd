"""An episode depends on its task, team size, seed and actions, to the bit, and on nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from xmarl_envs import TASKS, VectorEnv, make_task

from tests.envs import trajectory
from tests.envs.trajectory import N_AGENTS, SEED, play

tasks = pytest.mark.parametrize("name", TASKS)


@tasks
def test_the_episode_that_is_hashed_is_a_crowded_one(name: str) -> None:
    assert play(VectorEnv(make_task(name, N_AGENTS)), SEED)[1] > 20


@tasks
def test_other_seeds_give_other_episodes(name: str) -> None:
    env = VectorEnv(make_task(name, N_AGENTS))
    assert len({play(env, seed)[0] for seed in range(4)}) == 4


@tasks
def test_a_fresh_environment_and_a_used_one_play_the_same(name: str) -> None:
    expected, _ = play(VectorEnv(make_task(name, N_AGENTS)), SEED)
    used = VectorEnv(make_task(name, N_AGENTS))
    play(used, SEED + 1)
    play(used, SEED + 2)
    assert play(used, SEED)[0] == expected


@tasks
@pytest.mark.parametrize(("n_episodes", "slot"), [(2, 1), (5, 0), (5, 3)])
def test_neighbours_in_the_batch_do_not_matter(name: str, n_episodes: int, slot: int) -> None:
    expected, _ = play(VectorEnv(make_task(name, N_AGENTS)), SEED)
    env = VectorEnv(make_task(name, N_AGENTS), n_episodes, copies_per_space=1)
    assert play(env, SEED, slot)[0] == expected
    assert play(env, SEED, slot, meddling=True)[0] == expected


@pytest.mark.parametrize("hash_seed", ["0", "12345"])
def test_other_processes_play_the_same(hash_seed: str) -> None:
    expected = {name: play(VectorEnv(make_task(name, N_AGENTS)), SEED)[0] for name in TASKS}
    output = subprocess.run(
        [sys.executable, Path(trajectory.__file__)],
        env={**os.environ, "PYTHONHASHSEED": hash_seed},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert dict(line.split() for line in output.splitlines()) == expected
