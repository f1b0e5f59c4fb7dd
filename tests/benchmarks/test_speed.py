"""Speed of episodes compared with VMAS, MPE2 and JaxMARL: `make bench`.

Each steps three agents for 400 cycles with observations, rewards and endings, and resets what has ended; no
episode is longer than 400 cycles. Actions are random, drawn beforehand, and held for 10 cycles, so that
agents move about; ours and VMAS take the same ones. Torch gets one thread; ours is single-threaded.

VMAS runs its own navigation with contacts, without the lidar, which blind agents do not have. It does not
reset by itself: we call `reset()`, its fastest way, if all of a batch have ended (nearly all do after 400
cycles), and `reset_at` otherwise. MPE2's simple_spread is another task, also of three agents that may touch.

JaxMARL runs its simple_spread with continuous actions, compiled, on one thread. `loop` calls a compiled step
for each cycle, as a policy outside of JAX needs it. `scan` compiles all 400 cycles into one call: only a
policy written in JAX can take part in it. It needs a Python with `jaxmarl`, named by XMARL_BENCH_JAXMARL.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pymunk
import pytest
import torch
from mpe2 import simple_spread_v3
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture
from xmarl_envs import BlindNavigation, TaskParallelEnv
from xmarl_envs.free_flight import MOVES
from xmarl_envs.gymnasium_vector_env import TeamVectorEnv
from xmarl_envs.world import TIME_STEP, World

from tests.benchmarks.conftest import Report
from tests.benchmarks.jaxmarl_process import JaxMarl
from tests.benchmarks.side_by_side import Run, clocked, side_by_side
from tests.envs.vmas_twin import VmasTwin

pytestmark = pytest.mark.benchmark(timer=time.process_time)

TASK = BlindNavigation(3)
CYCLES, HELD = 400, 10
SHARED = 64  # copies_per_space, as in training
ONE = "one episode, ParallelEnv"
Actions = NDArray[np.float32]


def random_actions(n_episodes: int, n_agents: int = TASK.n_agents) -> Actions:
    """(CYCLES, B, N, 2)"""
    rng = np.random.default_rng(0)
    drawn = rng.uniform(-1, 1, (CYCLES // HELD, n_episodes, n_agents, 2))
    return np.repeat(drawn.astype(np.float32), HELD, axis=0)


def batch(n_episodes: int) -> str:
    return f"{n_episodes} episodes, shared Spaces"


def our_episode() -> Run:
    env = TaskParallelEnv(TASK, max_cycles=CYCLES)
    env.reset(seed=0)
    actions = [dict(zip(env.agents, action[0], strict=True)) for action in random_actions(1)]

    def run() -> None:
        for action in actions:
            env.step(action)
            if not env.agents:
                env.reset()

    return run


def our_batch(n_episodes: int, copies_per_space: int, task: BlindNavigation = TASK) -> Run:
    env = TeamVectorEnv(
        task, n_episodes, CYCLES, copies_per_space=copies_per_space, autoreset_mode="SameStep"
    )
    env.reset(seed=0)
    actions = random_actions(n_episodes, task.n_agents)

    def run() -> None:
        for action in actions:
            env.step(action)

    return run


def vmas_batch(n_episodes: int, task: BlindNavigation = TASK) -> Run:
    env = VmasTwin(task.name, task.n_agents, n_episodes).env
    env.max_steps = CYCLES
    env.reset()
    actions = [
        [torch.tensor(action[:, i]) for i in range(task.n_agents)]
        for action in random_actions(n_episodes, task.n_agents)
    ]

    def run() -> None:
        for action in actions:
            *_, done, _ = env.step(action)
            if done.all():
                env.reset()
            elif done.any():
                for episode in torch.nonzero(done)[:, 0].tolist():
                    env.reset_at(episode)

    return run


def mpe2_episode(continuous_actions: bool) -> Run:
    env = simple_spread_v3.parallel_env(max_cycles=CYCLES, continuous_actions=continuous_actions)
    env.reset(seed=0)
    for i, agent in enumerate(env.agents):
        env.action_space(agent).seed(i)
    drawn = [{agent: env.action_space(agent).sample() for agent in env.agents} for _ in range(CYCLES // HELD)]

    def run() -> None:
        for action in drawn:
            for _ in range(HELD):
                env.step(action)
                if not env.agents:
                    env.reset()

    return run


@pytest.mark.parametrize(
    ("peer", "theirs", "bar"),
    [
        ("VMAS, num_envs=1", lambda: vmas_batch(1), 15.0),
        ("MPE2 simple_spread", lambda: mpe2_episode(continuous_actions=False), 5.0),
        ("MPE2 simple_spread, continuous", lambda: mpe2_episode(continuous_actions=True), 5.0),
    ],
)
def test_one_episode(
    benchmark: BenchmarkFixture, report: Report, peer: str, theirs: Callable[[], Run], bar: float
) -> None:
    benchmark.group = "ParallelEnv, one episode"
    side_by_side(
        benchmark, report, ONE, peer, our_episode(), clocked(theirs()), pieces=CYCLES, bar=bar, rounds=11
    )


@pytest.mark.parametrize(("n_episodes", "bar"), [(64, 5.0), (1024, 1.5)])
def test_a_batch(benchmark: BenchmarkFixture, report: Report, n_episodes: int, bar: float) -> None:
    benchmark.group = f"{n_episodes} episodes"
    ours, theirs = our_batch(n_episodes, SHARED), vmas_batch(n_episodes)
    pieces = CYCLES * n_episodes
    side_by_side(benchmark, report, batch(n_episodes), "VMAS", ours, clocked(theirs), pieces=pieces, bar=bar)


def test_a_larger_team(benchmark: BenchmarkFixture, report: Report) -> None:
    benchmark.group = "1024 episodes of 8 agents"
    task = BlindNavigation(8)
    ours, theirs = our_batch(1024, SHARED, task), vmas_batch(1024, task)
    what = "1024 episodes of 8 agents, shared Spaces"
    pieces = CYCLES * 1024
    side_by_side(benchmark, report, what, "VMAS", ours, clocked(theirs), pieces=pieces, bar=2.0, rounds=3)


def test_a_larger_batch(benchmark: BenchmarkFixture, report: Report) -> None:
    """An episode takes no longer in a larger batch."""
    benchmark.group = "4096 episodes"
    ours, fewer = our_batch(4096, SHARED), our_batch(1024, SHARED)
    side_by_side(
        benchmark, report, batch(4096), "the same, 1024", ours, clocked(fewer),
        pieces=CYCLES * 4096, their_pieces=CYCLES * 1024, bar=0.9, rounds=3,
    )  # fmt: skip


def test_a_batch_as_scored(benchmark: BenchmarkFixture, report: Report) -> None:
    """One Space per episode; without a bar."""
    benchmark.group = "64 episodes"
    ours, theirs = our_batch(64, copies_per_space=1), vmas_batch(64)
    what = "64 episodes, a Space each (scoring)"
    side_by_side(benchmark, report, what, "VMAS", ours, clocked(theirs), pieces=CYCLES * 64, rounds=3)


@pytest.mark.parametrize("way", ["scan", "loop"])
@pytest.mark.parametrize("n_episodes", [1, 64, 1024])
def test_beside_jaxmarl(benchmark: BenchmarkFixture, report: Report, n_episodes: int, way: str) -> None:
    benchmark.group = f"{n_episodes} episodes"
    ours = our_episode() if n_episodes == 1 else our_batch(n_episodes, SHARED)
    what = ONE if n_episodes == 1 else batch(n_episodes)
    with JaxMarl(n_episodes, way, CYCLES, HELD) as peer:
        side_by_side(
            benchmark, report, what, f"JaxMARL simple_spread, {way}", ours, peer.seconds,
            pieces=CYCLES * n_episodes, remark=f"compiled in {peer.compiled:.1f} s, not counted",
        )  # fmt: skip


def our_physics(n_episodes: int) -> Run:
    world = World(TASK, n_episodes, SHARED)
    agents = np.array([TASK.spawn(np.random.default_rng(k)).agents for k in range(n_episodes)])
    forces = TASK.u_mult * random_actions(n_episodes).astype(np.float64)

    def run() -> None:
        world.place(np.arange(n_episodes), agents, np.zeros((n_episodes, 0, 2)))
        for force in forces:
            world.step(force)

    return run


def bare_space(n_episodes: int, moves_per_step: int) -> Run:
    """Only `step` of one Space with all agents in flight: no forces set, nothing read."""
    rng = np.random.default_rng(0)
    space = pymunk.Space()
    discs, places = [], []
    for episode in range(n_episodes):
        for x, y in TASK.spawn(np.random.default_rng(episode)).agents:
            disc = pymunk.Body(1.0, float("inf"))
            space.add(disc, pymunk.Circle(disc, TASK.radius))
            discs.append(disc)
            places.append((x + 64.0 * (episode % 8), y + 64.0 * (episode // 8)))
    speeds = rng.uniform(-0.3, 0.3, (len(discs), 2)).tolist()

    def run() -> None:
        for disc, place, speed in zip(discs, places, speeds, strict=True):
            disc.position, disc.velocity = place, tuple(speed)
        for _ in range(CYCLES * moves_per_step):
            space.step(TIME_STEP / moves_per_step)

    return run


@pytest.mark.parametrize(("moves_per_step", "bar"), [(MOVES, 0.6), (2, None)])
def test_physics_alone(
    benchmark: BenchmarkFixture, report: Report, moves_per_step: int, bar: float | None
) -> None:
    """Ours checks for contacts MOVES times in a step, so the bare Space is stepped as often.

    The other one is stepped twice, as often as VMAS, so its discs overlap three times as deep.
    """
    benchmark.group = "physics of 64 episodes"
    ours, theirs = our_physics(64), bare_space(64, moves_per_step)
    what, peer = "World.step, 64 episodes", f"pymunk, bare Space.step, {moves_per_step} a step"
    side_by_side(benchmark, report, what, peer, ours, clocked(theirs), pieces=CYCLES * 64, bar=bar)
