"""A wrapper for TorchRL whose infos hold every key from `reset` on."""

from __future__ import annotations

from typing import Any

from pettingzoo.utils import BaseParallelWrapper

from xmarl_envs.parallel import Array, TaskParallelEnv


class InfoAtReset(BaseParallelWrapper[str, Array, Array]):  # type: ignore[misc]  # no py.typed in pettingzoo
    """The same environment, but the infos of `reset` hold the keys of every step's, all False.

    `torchrl.envs.PettingZooWrapper` keeps only the keys of the first `reset`. Not for use under SuperSuit:
    it would overwrite the infos of an episode's last step with those of the reset.
    """

    env: TaskParallelEnv

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        observations, infos = self.env.reset(seed, options)
        keys = (self.env.task.success_key, "agent_collision", "object_collision")
        return observations, {agent: {**dict.fromkeys(keys, False), **info} for agent, info in infos.items()}
