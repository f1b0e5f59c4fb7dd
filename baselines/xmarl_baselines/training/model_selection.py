"""Keeps the best policy of a run, by deterministic episodes that neither training nor scoring plays.

PPO improves the stochastic policy; the deterministic one does not improve steadily. Agents that separate by
chance while exploring may wait for each other for ever without noise. Every validated policy is kept, so that
explanations can be studied along training (Kailas et al., ICML 2025, appendix on training iterations).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save

from xmarl_baselines.training.mappo import MAPPO, IterationCallback
from xmarl_baselines.training.run_files import damaged, read_run_file
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.policy.default_policies import selection_key
from xmarl_bench.records.files import write_atomically, write_json
from xmarl_bench.rollout.cell import Cell, Sampling
from xmarl_bench.rollout.episodes import Floats, play

VALIDATION = Sampling(episodes=100, seed=1_000)  # scoring plays seed 0 by default
MEASURES = ("success_rate", "no_agent_collision", "no_object_collision", "makespan")
Record = dict[str, Any]  # frames, and the measures at that frame


def plain_actor(model: MAPPO) -> GraphPolicy:
    """A copy of the actor in evaluation mode, to be saved and scored."""
    actor = GraphPolicy(model.policy.actor.architecture)
    actor.load_state_dict(model.policy.actor.state_dict())
    return actor.eval()


def weights_at(run: Path, record: Record) -> Path:
    """The file in a run's folder that holds the weights of a validation."""
    return run / "validated" / f"{record['frames']:010d}.safetensors"


class ModelSelection(IterationCallback):
    """Plays the validation episodes at multiples of `every` frames, and keeps weights and results.

    `folder` holds curve.json, one record per validation, and validated/FRAMES.safetensors; both survive an
    interruption. `best` ignores policies from before frame `after`, when the attention-entropy term had not
    reached its full weight, if there are later ones.
    """

    def __init__(self, folder: Path, cell: Cell, *, every: int, after: float) -> None:
        super().__init__()
        self._folder, self._cell, self._every, self._after = folder, cell, every, after
        self._last = 0

    def _on_training_start(self) -> None:
        self._last = self.num_timesteps

    def _on_rollout_start(self) -> None:
        # Multiples, so that a resumed run validates at the same frames as an uninterrupted one.
        if self.num_timesteps // self._every > self._last // self._every:
            self._last = self.num_timesteps
            self.validate()

    def validate(self) -> None:
        """Measure the current policy and keep it."""
        policy = plain_actor(self.model)

        @torch.inference_mode()
        def act(observation: Floats, _: Sequence[int]) -> tuple[Floats, Floats]:
            # One batch, unlike scoring: the last bits do not matter here.
            distribution, memory = policy.step(torch.from_numpy(observation))
            return distribution.choice.numpy(), memory.numpy()

        episodes = play(
            self._cell.make(),
            act,
            VALIDATION.seeds,
            parallel_episodes=VALIDATION.episodes,
            max_cycles=VALIDATION.max_cycles,
        )
        frames = self.model.num_timesteps
        record: Record = {"frames": frames}
        for name in MEASURES:
            record[name] = float(np.mean([getattr(episode, name) for episode in episodes]))
            self.logger.record(f"validation/{name}", record[name])
        if not self._cell.make().has_objects:
            record["no_object_collision"] = None
        weights = weights_at(self._folder, record)
        weights.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(weights, save(policy.state_dict()))
        earlier = [row for row in self.curve() if row["frames"] < frames]
        write_json(self._folder / "curve.json", [*earlier, record])

    def curve(self) -> list[Record]:
        """The records so far, in order of frames."""
        path = self._folder / "curve.json"
        return read_run_file(path, _validations) if path.exists() else []

    def best(self) -> tuple[GraphPolicy, Record]:
        """The best validated policy and its record."""
        curve = self.curve()
        late = [record for record in curve if record["frames"] >= self._after] or curve[-1:]
        record = max(late, key=lambda row: selection_key(self._cell.task, row))
        return self.policy_at(record), record

    def policy_at(self, record: Record) -> GraphPolicy:
        policy = plain_actor(self.model)
        weights = weights_at(self._folder, record)
        try:
            policy.load_state_dict(load_file(weights))
        except (SafetensorError, RuntimeError):
            raise damaged(weights) from None
        return policy


def _validations(curve: list[Record]) -> list[Record]:
    """The curve. Raises KeyError or TypeError if it holds anything but validations."""
    for record in curve:
        _ = [record[name] for name in ("frames", *MEASURES)]
    return curve
