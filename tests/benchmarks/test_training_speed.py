"""How fast the trainer is, beside BenchMARL's MAPPO: `make bench`.

One iteration of the paper's schedule for navigation (Kailas et al., ICML 2025: 18,000 frames, then 30 epochs
in minibatches of 800), one thread. BenchMARL plays VMAS navigation with `collisions=False`, which takes away
the lidar that blind agents lack, and contacts too: it computes less than ours does. Its model is its GNN
(full topology, GATv2Conv, self loops), then an MLP of 256, 256.

`ratio` is BenchMARL's time over ours, the better of ROUNDS each. Of ours, `environment_share`,
`inference_share` and `update_share` say where the time goes, and `matrix_peak_share` which part of the speed
of a large float32 matrix product on this thread the update's matrix products reach, all else included.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture
from torch import nn
from xmarl_baselines.mappo import MAPPO
from xmarl_baselines.recipes import PAPER_NAVIGATION
from xmarl_baselines.trainer import Run, build

FRAMES, TEAMS, EPOCHS, MINIBATCH, ROUNDS = 18_000, 120, 30, 800, 2


def ours(n_agents: int) -> MAPPO:
    recipe = replace(
        PAPER_NAVIGATION,
        critic=(32, 32),
        n_envs=TEAMS,
        n_steps=FRAMES // TEAMS,
        n_epochs=EPOCHS,
        batch_size=900,  # the recipe asks for a divisor; the paper's has a short last minibatch:
    )
    model = build(Run(recipe, n_agents), seed=0)
    model.batch_size = MINIBATCH
    return model


@contextmanager
def timed(owner: Any, name: str, spent: dict[str, float]) -> Iterator[None]:
    """Adds the time inside `owner.name` to spent[name]."""
    inner = getattr(owner, name)

    def wrapper(*args: Any, **kwargs: Any) -> Any:
        started = time.perf_counter()
        try:
            return inner(*args, **kwargs)
        finally:
            spent[name] = spent.get(name, 0.0) + time.perf_counter() - started

    setattr(owner, name, wrapper)
    try:
        yield
    finally:
        setattr(owner, name, inner)


def matrix_peak() -> float:
    """Floating-point operations per second of a 2048 x 2048 float32 product, the best of ten."""
    a = torch.rand(2048, 2048)
    best = float("inf")
    for _ in range(10):
        started = time.perf_counter()
        a @ a
        best = min(best, time.perf_counter() - started)
    return 2 * 2048**3 / best


def update_operations(model: MAPPO, n_agents: int) -> float:
    """Of the matrix products of one iteration's update: 2 forward and 4 backward per weight and row."""
    actor, critic = (
        sum(layer.weight.numel() for layer in network.modules() if isinstance(layer, nn.Linear))
        for network in (model.policy.actor, model.policy.critic)
    )
    return 6.0 * EPOCHS * FRAMES * (actor * n_agents + critic)


def benchmarl(folder: Path) -> Callable[[], None]:
    """An experiment of one iteration, ready to run."""
    pytest.importorskip("benchmarl", reason="of the `bench` extra")
    from torchrl import collectors

    # Its name until TorchRL 0.13; BenchMARL 1.5 still asks for it.
    collectors.SyncDataCollector = collectors.Collector
    from benchmarl.algorithms import MappoConfig
    from benchmarl.environments import VmasTask
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models import GnnConfig, MlpConfig, SequenceModelConfig
    from torch_geometric.nn import GATv2Conv

    config = ExperimentConfig.get_from_yaml()
    config.on_policy_collected_frames_per_batch = FRAMES
    config.on_policy_n_envs_per_worker = TEAMS
    config.on_policy_n_minibatch_iters = EPOCHS
    config.on_policy_minibatch_size = MINIBATCH
    config.max_n_iters, config.max_n_frames = 1, None
    config.evaluation, config.loggers, config.create_json = False, [], False
    config.checkpoint_interval, config.checkpoint_at_end = 0, False
    folder.mkdir()
    config.save_folder = str(folder)
    task = VmasTask.NAVIGATION.get_from_yaml()
    task.config |= {"n_agents": 3, "collisions": False, "max_steps": 400}
    gnn = GnnConfig(topology="full", self_loops=True, gnn_class=GATv2Conv, gnn_kwargs={})
    mlp = MlpConfig(num_cells=[256, 256], activation_class=nn.Tanh, layer_class=nn.Linear)
    experiment = Experiment(
        task=task,
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=SequenceModelConfig(model_configs=[gnn, mlp], intermediate_sizes=[32]),
        critic_model_config=MlpConfig(num_cells=[32, 32], activation_class=nn.Tanh, layer_class=nn.Linear),
        seed=0,
        config=config,
    )
    run: Callable[[], None] = experiment.run
    return run


@pytest.mark.parametrize("n_agents", [3, 4, 5])
def test_iteration_of_the_papers_schedule(benchmark: BenchmarkFixture, n_agents: int, tmp_path: Path) -> None:
    model, spent = ours(n_agents), dict[str, float]()
    model.learn(TEAMS)  # SB3 sets itself up
    with (
        timed(model.env, "step", spent),
        timed(model.policy, "forward", spent),
        timed(model, "train", spent),
    ):
        benchmark.pedantic(  # type: ignore[no-untyped-call]
            lambda: model.learn(FRAMES, reset_num_timesteps=False), rounds=ROUNDS
        )
    if benchmark.stats is None:
        return
    stats = benchmark.stats.stats
    for name, share in {"step": "environment", "forward": "inference", "train": "update"}.items():
        benchmark.extra_info[f"{share}_share"] = round(spent[name] / stats.total, 2)
    reached = update_operations(model, n_agents) * ROUNDS / spent["train"]
    benchmark.extra_info["matrix_peak_share"] = round(reached / matrix_peak(), 2)
    if n_agents == 3:
        theirs = []
        for k in range(ROUNDS):
            run = benchmarl(tmp_path / str(k))
            started = time.perf_counter()
            run()
            theirs.append(time.perf_counter() - started)
        benchmark.extra_info["benchmarl_s"] = round(min(theirs), 1)
        benchmark.extra_info["ratio"] = round(min(theirs) / stats.min, 2)
