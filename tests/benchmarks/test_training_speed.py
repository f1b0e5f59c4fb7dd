"""Speed of the trainer compared with BenchMARL's MAPPO: `make bench`.

One iteration of the paper's schedule for navigation (Kailas et al., ICML 2025: 18,000 frames, then 30 epochs
in minibatches of 800), on one thread, in CPU time, so other load on the machine does not count. BenchMARL
plays VMAS navigation with `collisions=False`, which removes the lidar that blind agents lack, but also
contacts: it computes less than ours. Its model is described in benchmarl_peer.py.

Also the time to a good team: our recipe on our task, BenchMARL's default settings on VMAS navigation.

The matrix peak is the speed of a large float32 product on this thread: an update whose other work took no
time would be level with it. At N = 3 about half of an update is matrix products. Tanh takes an eighth, and
nothing faster has its bits: numpy's, in place, makes an update 1.13 times as fast, but gives other weights.
One autograd function for a linear layer and tanh, in place, keeps the bits and gains 1 %: there is none.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture
from torch import nn
from xmarl_baselines.paper_schedule import PAPER_SCHEDULE
from xmarl_baselines.training.mappo import MAPPO
from xmarl_baselines.training.model_selection import ModelSelection
from xmarl_baselines.training.recipes import recipe_for
from xmarl_baselines.training.trainer import Run, build, train

from tests.benchmarks.conftest import Report
from tests.benchmarks.side_by_side import clocked, record

TASK = "blind_navigation_v0"
SCHEDULE = PAPER_SCHEDULE[TASK]
FRAMES = SCHEDULE.n_envs * SCHEDULE.n_steps
ROUNDS = 2  # iterations of ours and of BenchMARL
SIZES, TURNS, SHORTER = (3, 4, 5, 8), 5, 10
UPDATES, OF_THE_PEAK = 7, 0.45  # rounds; bar
FASTER_THAN_BENCHMARL = 1.5  # bar
SUCCESS, COLLISION_FREE, LONGER = 0.95, 0.90, 4.0  # rates to reach; BenchMARL's time limit, in our times


class Parts(NamedTuple):
    """CPU seconds of one iteration."""

    environment: float
    inference: float
    update: float


def ours(n_agents: int, **changes: Any) -> MAPPO:
    """The untrained learner of the paper's schedule."""
    return build(Run(replace(SCHEDULE, **changes), n_agents), seed=0)


def iteration(model: MAPPO) -> Parts:
    spent: dict[str, float] = {}
    with timed(model.env, "step", spent), timed(model.policy, "forward", spent), timed(model, "train", spent):
        model.learn(FRAMES, reset_num_timesteps=False)
    return Parts(spent["step"], spent["forward"], spent["train"])


def benchmarl_peer() -> ModuleType:
    """Skips if BenchMARL is not installed."""
    if find_spec("benchmarl") is None:
        pytest.skip("BenchMARL is not installed: install the `bench` extra")
    return import_module("tests.benchmarks.benchmarl_peer")


@contextmanager
def timed(owner: Any, name: str, spent: dict[str, float]) -> Iterator[None]:
    """Adds the time inside `owner.name` to spent[name]."""
    inner = getattr(owner, name)

    def wrapper(*args: Any, **kwargs: Any) -> Any:
        started = time.process_time()
        try:
            return inner(*args, **kwargs)
        finally:
            spent[name] = spent.get(name, 0.0) + time.process_time() - started

    setattr(owner, name, wrapper)
    try:
        yield
    finally:
        setattr(owner, name, inner)


PEAK_WIDTH = 2048


def matrix_product() -> float:
    """CPU seconds of an operation in a product of two large matrices, the best of two."""
    a = torch.rand(PEAK_WIDTH, PEAK_WIDTH)
    return min(clocked(lambda: a @ a)() for _ in range(2)) / (2 * PEAK_WIDTH**3)


def update_operations(model: MAPPO, n_agents: int, frames: int) -> float:
    """Operations in the matrix products of one update: 2 forward and 4 backward per weight and row."""
    actor, critic = (
        sum(layer.weight.numel() for layer in network.modules() if isinstance(layer, nn.Linear))
        for network in (model.policy.actor, model.policy.critic)
    )
    return 6.0 * model.n_epochs * frames * (actor * n_agents + critic)


@pytest.mark.benchmark(timer=time.process_time)
def test_growth_with_the_team(benchmark: BenchmarkFixture, report: Report) -> None:
    """Times team sizes in turns with a tenth of the epochs, and multiplies the update's time by ten."""
    models = {n_agents: ours(n_agents, n_epochs=SCHEDULE.n_epochs // SHORTER) for n_agents in SIZES}
    turns: dict[int, list[Parts]] = {n_agents: [] for n_agents in SIZES}

    def one_each() -> None:
        for n_agents, model in models.items():
            parts = iteration(model)
            turns[n_agents].append(parts._replace(update=parts.update * SHORTER))

    benchmark.pedantic(one_each, rounds=TURNS)  # type: ignore[no-untyped-call]
    if benchmark.stats is None:
        return
    first = np.array([sum(parts) for parts in turns[SIZES[0]]])
    for n_agents in SIZES:
        seconds = np.array(turns[n_agents])
        growth = np.median(seconds.sum(axis=1) / first)
        benchmark.extra_info[f"N = {n_agents}"] = {
            **dict(zip(Parts._fields, np.median(seconds, axis=0).tolist(), strict=True)),
            "growth": float(growth),
        }
        report(
            "iteration of the paper's navigation schedule: CPU s of environment, inference, update; growth",
            f"N = {n_agents}"
            + "".join(f"{each:>9.2f}" for each in np.median(seconds, axis=0))
            + f"{growth:>9.2f}",
        )


@pytest.mark.benchmark(timer=time.process_time)
def test_update_beside_the_matrix_peak(benchmark: BenchmarkFixture, report: Report) -> None:
    """An epoch in minibatches of 2000, on the shipped recipe's network."""
    recipe = replace(recipe_for(TASK), n_envs=120, n_steps=50, n_epochs=1, batch_size=2000)
    frames = recipe.n_envs * recipe.n_steps
    model = build(Run(recipe, 3), seed=0)
    model.learn(frames)
    operations, peak = update_operations(model, 3, frames), list[float]()
    benchmark.pedantic(  # type: ignore[no-untyped-call]
        model.train, setup=lambda: peak.append(matrix_product() * operations), rounds=UPDATES
    )
    if benchmark.stats is not None:
        record(
            benchmark, report, "MAPPO update, minibatch 2000", "its matrix products at the matrix peak",
            ours=benchmark.stats.stats.data, theirs=peak, unit="ms", bar=OF_THE_PEAK,
        )  # fmt: skip


@pytest.mark.benchmark(timer=time.process_time)
def test_iteration_beside_benchmarl(benchmark: BenchmarkFixture, report: Report, tmp_path: Path) -> None:
    """In turns, ROUNDS each."""
    peer = benchmarl_peer()
    model, theirs = ours(3), list[float]()

    def time_theirs() -> None:
        config = peer.settings(
            tmp_path / str(len(theirs)),
            on_policy_collected_frames_per_batch=FRAMES,
            on_policy_n_envs_per_worker=SCHEDULE.n_envs,
            on_policy_n_minibatch_iters=SCHEDULE.n_epochs,
            on_policy_minibatch_size=SCHEDULE.batch_size,
            max_n_iters=1,
            max_n_frames=None,
            evaluation=False,
        )
        run = peer.experiment(config, peer.mlp([32, 32]), collisions=False, max_steps=400)
        started = time.process_time()
        run.run()
        theirs.append(time.process_time() - started)

    benchmark.pedantic(  # type: ignore[no-untyped-call]
        lambda: model.learn(FRAMES, reset_num_timesteps=False), setup=time_theirs, rounds=ROUNDS
    )
    if benchmark.stats is None:
        return
    record(
        benchmark, report, "iteration of the paper's navigation schedule", "BenchMARL's MAPPO",
        ours=benchmark.stats.stats.data, theirs=theirs, unit="s", bar=FASTER_THAN_BENCHMARL,
    )  # fmt: skip


class _Reached(Exception):  # noqa: N818
    """The team is good enough."""


@pytest.mark.benchmark(timer=time.process_time)
def test_time_to_success_beside_benchmarl(
    benchmark: BenchmarkFixture, report: Report, tmp_path: Path
) -> None:
    """CPU seconds until both rates are reached, with our recipe and with BenchMARL's default settings.

    Ours validates at each tenth of training, BenchMARL every 60,000 frames, on 100 deterministic episodes
    each; validation time is not counted. BenchMARL is stopped at LONGER times our time. Its agents are not
    blind: VMAS navigation gives them lidar if agents can touch. A contact is one that VMAS penalises.
    """
    peer = benchmarl_peer()
    spent: dict[str, float] = {}
    run, folder = Run(recipe_for(TASK)), tmp_path / "ours"

    def look(frames: int, _: dict[str, float]) -> None:
        if good_enough(folder):
            raise _Reached

    def train_ours() -> None:
        with suppress(_Reached), timed(ModelSelection, "validate", spent):
            train(run, folder, report=look)

    benchmark.pedantic(train_ours, rounds=1)  # type: ignore[no-untyped-call]
    last = json.loads((folder / "curve.json").read_text())[-1]
    assert good_enough(folder), f"after all frames: {last}"
    if benchmark.stats is None:
        return
    mine = benchmark.stats.stats.min - spent["validate"]
    theirs = peer.train_until(tmp_path / "theirs", SUCCESS, COLLISION_FREE, LONGER * mine)
    frames = f"ours {last['frames'] / 1e6:.1f} M frames, theirs {theirs.frames / 1e6:.1f} M"
    rates = " and ".join(f"{rate:.2f}" for rate in theirs.rates)
    record(
        benchmark, report, f"training to {SUCCESS} success and {COLLISION_FREE} collision-free",
        "BenchMARL's MAPPO, default settings", ours=[mine], theirs=[theirs.seconds], unit="s",
        remark=frames if theirs.reached else f"{frames}, stopped at {rates}",
    )  # fmt: skip


def good_enough(folder: Path) -> bool:
    """Whether the last validation of a run reaches both rates."""
    curve = folder / "curve.json"
    if not curve.exists():
        return False
    last = json.loads(curve.read_text())[-1]
    return bool(last["success_rate"] >= SUCCESS and last["no_agent_collision"] >= COLLISION_FREE)
