"""Infos whose keys are there from `reset` on, for TorchRL."""

from __future__ import annotations

from typing import Any

from pettingzoo.utils import BaseParallelWrapper

from xmarl_envs.parallel import Array, TaskParallelEnv


class InfoAtReset(BaseParallelWrapper[str, Array, Array]):  # type: ignore[misc]  # no py.typed in pettingzoo
    """The same environment, but the infos of `reset` hold the keys of every step's, all False.

    For `torchrl.envs.PettingZooWrapper`, which takes from a first `reset` what infos there are and drops all
    others. Not for SuperSuit, which puts the infos of a reset over those of the step that ended the episode.
    """

    env: TaskParallelEnv

    def __init__(self, env: TaskParallelEnv) -> None:
        super().__init__(env)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        observations, infos = self.env.reset(seed, options)
        keys = (self.env.task.success_key, "agent_collision", "object_collision")
        return observations, {agent: {**dict.fromkeys(keys, False), **info} for agent, info in infos.items()}
