"""Keeps the best policy of a run, by deterministic episodes that neither training nor scoring plays.

The deterministic policy is not what PPO improves, and it does not improve steadily: agents that part by
chance while exploring can wait for each other for ever without it.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.torch import load_file, save
from stable_baselines3.common.callbacks import BaseCallback

from xmarl_baselines.mappo import MAPPO
from xmarl_bench.files import write_atomically, write_json
from xmarl_bench.policy import GraphPolicy
from xmarl_bench.request import Cell, Sampling
from xmarl_bench.rollout import roll_out

VALIDATION = Sampling(episodes=100, seed=1_000)  # scoring plays seed 0 unless told otherwise
MEASURES = ("success_rate", "no_agent_collision", "makespan")


def plain_actor(model: MAPPO) -> GraphPolicy:
    """The actor without the trainer's faster layers: what is saved and scored."""
    actor = GraphPolicy(model.policy.actor.architecture)
    actor.load_state_dict(model.policy.actor.state_dict())
    return actor.eval()


class ModelSelection(BaseCallback):
    """Every `every` frames, play the validation episodes and keep the policy if none was better.

    Better is: more successful, up to `enough` success; from there on, fewer episodes with a collision.
    Policies from before frame `after` are not looked at (the attention-entropy term was not whole yet).
    `folder` holds best.safetensors and best.json, which outlive an interruption.
    """

    def __init__(self, folder: Path, cell: Cell, every: int, after: float, enough: float) -> None:
        super().__init__()
        self._weights, self._record = folder / "best.safetensors", folder / "best.json"
        self._cell, self._every, self._after, self._enough = cell, every, after, enough
        self._last = 0

    def _on_training_start(self) -> None:
        self._last = self.num_timesteps

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps - self._last >= self._every and self.num_timesteps >= self._after:
            self._last = self.num_timesteps
            self.validate()

    def validate(self) -> None:
        """Measure the present policy; keep it if it is the best so far."""
        assert isinstance(self.model, MAPPO)
        policy = plain_actor(self.model)
        episodes = roll_out(
            self._cell.make(),
            policy,
            VALIDATION.seeds,
            max_cycles=VALIDATION.max_cycles,
            parallel_episodes=VALIDATION.episodes,
        )
        seen = {name: float(np.mean([getattr(episode, name) for episode in episodes])) for name in MEASURES}
        for name, value in seen.items():
            self.logger.record(f"validation/{name}", value)
        best = json.loads(self._record.read_text()) if self._record.exists() else None
        if best is not None and self._rank(seen) <= self._rank(best):
            return
        weights = save(policy.state_dict())
        write_atomically(self._weights, weights)
        digest = hashlib.sha256(weights).hexdigest()
        write_json(self._record, {"frames": self.num_timesteps, "weights_sha256": digest, **seen})

    def best(self) -> tuple[GraphPolicy, dict[str, Any]]:
        """The policy kept, and the record of its validation."""
        assert isinstance(self.model, MAPPO)
        policy = plain_actor(self.model)
        policy.load_state_dict(load_file(self._weights))
        record: dict[str, Any] = json.loads(self._record.read_text())
        return policy, record

    def _rank(self, seen: dict[str, Any]) -> tuple[float, float]:
        return min(seen["success_rate"], self._enough), seen["no_agent_collision"]
