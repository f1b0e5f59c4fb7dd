"""BenchMARL's MAPPO, with the graph-attention actor of the reference policies, as a peer of the trainer.

The model is BenchMARL's GNN (full topology, GATv2Conv, self loops), then its MLP of 256, 256, as in the
navigation policies. Needs BenchMARL, from the `bench` extra.
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from torch import Tensor

from tests.helpers import benchmarl_training
from tests.helpers.benchmarl_training import gnn, mlp, navigation, sequence, settings

__all__ = ["experiment", "mlp", "settings", "train_until"]
WIDTH, DECODER, GOAL_RADIUS = 32, [256, 256], 0.1  # layer, MLP after it, m in VMAS
EPISODES, EVERY = 100, 60_000  # per evaluation; frames between evaluations


def experiment(
    config: ExperimentConfig, critic: MlpConfig, callback: Callback | None = None, **task: object
) -> Experiment:
    """MAPPO with the actor of the reference policies, ready to run.

    task: settings of the scenario that differ from BenchMARL's.
    """
    actor = sequence([gnn(self_loops=True), mlp(DECODER)], WIDTH)
    on = navigation(**task)
    return benchmarl_training.experiment(config, actor, critic, callback=callback, task=on)


def rates(rollouts: list[Any]) -> tuple[float, float]:
    """Evaluation episodes -> fraction of agents at their goals at the end, of episodes without contacts."""
    arrived, free = [], []
    for rollout in rollouts:
        ends: Tensor = rollout["next", "done"].flatten()
        last = int(ends.float().argmax()) if bool(ends.any()) else len(ends) - 1  # the next episode follows
        from_goal = rollout["next", "agents", "observation"][last, :, 4:6]
        arrived.append((torch.linalg.vector_norm(from_goal, dim=-1) < GOAL_RADIUS).float().mean())
        free.append((rollout["next", "agents", "info", "agent_collisions"][: last + 1] == 0).all().float())
    return float(torch.stack(arrived).mean()), float(torch.stack(free).mean())


class Stopped(Exception):  # noqa: N818
    """The rates are reached, or the time is over."""


class Watch(Callback):  # type: ignore[misc]
    """Stops a training when both rates are reached, or after `limit` CPU seconds without evaluations."""

    def __init__(self, success: float, collision_free: float, limit: float) -> None:
        super().__init__()
        self.aim, self.limit = (success, collision_free), limit
        self.rates, self.reached = (0.0, 0.0), False  # at the last evaluation
        self.frames, self.seconds = 0, 0.0
        self.since = 0.0  # CPU clock since the last count

    def __getstate__(self) -> dict[str, Any]:
        """Leaves out the experiment, because BenchMARL pickles its callbacks."""
        return {**self.__dict__, "experiment": None}

    def on_train_end(self, training_td: Any, group: str) -> None:
        self.seconds += time.process_time() - self.since
        self.since = time.process_time()
        self.frames = self.experiment.total_frames
        if self.seconds > self.limit:
            raise Stopped

    def on_evaluation_end(self, rollouts: list[Any]) -> None:
        self.rates = rates(rollouts)
        self.reached = all(rate >= aim for rate, aim in zip(self.rates, self.aim, strict=True))
        if self.reached:
            raise Stopped
        self.since = time.process_time()


def train_until(folder: Path, success: float, collision_free: float, limit: float) -> Watch:
    """Train with BenchMARL's defaults until both rates are reached or `limit` CPU seconds are spent."""
    config = settings(
        folder,
        evaluation_episodes=EPISODES,
        evaluation_interval=EVERY,
        create_json=True,  # BenchMARL evaluates only if the result is kept
        max_n_frames=10**9,
    )
    watch = Watch(success, collision_free, limit)
    run = experiment(config, MlpConfig.get_from_yaml(), watch)
    watch.since = time.process_time()
    with suppress(Stopped):
        run.run()
    return watch
