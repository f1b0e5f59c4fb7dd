"""Explanations by simulation: the explainer plays on from the states that it explains.

S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from torch import Tensor
from xmarl_envs import TASKS, VectorEnv, make_task

from xmarl_bench.errors import InputError
from xmarl_bench.policy import Policy

SIMULATOR: Final = "simulator"  # name of the parameter, and of this access in entries
STATE_NAMES = ("position_x", "position_y", "velocity_x", "velocity_y")  # entries of an observation


@dataclass(frozen=True)
class Simulator:
    """Restarts an episode's world.

    Observations give the positions of agents, the seed those of targets and walls. Observations are float32,
    and cached contacts of the engine are lost: a restarted episode agrees with the recorded one up to
    rounding, which a contact amplifies.
    """

    task: str
    n_agents: int
    seed: int  # of the episode

    def restart(self, policy: Policy, observations: Tensor) -> VectorEnv:
        """(B, N, D) observations of this episode -> B copies of its world, each at the moment observed.

        They take the actions that the policy chooses, continuous or discrete ones. Every copy has its own
        physics, so what happens in it does not depend on the others. Raises InputError for observations of
        another shape, or of a task that does not observe positions and velocities.
        """
        if self.task not in TASKS:
            raise InputError(
                f"{self.task} is not a task of xmarl_envs, so it cannot be restarted: choose another "
                f"explainer."
            )
        task = make_task(self.task, self.n_agents).with_actions(policy.continuous_actions)
        missing = [name for name in STATE_NAMES if name not in task.observation_names]
        if missing:
            raise InputError(
                f"{self.task} cannot be restarted, because agents do not observe {', '.join(missing)}: "
                f"choose another task or explainer."
            )
        team, given = (self.n_agents, task.obs_dim + policy.memory_dim), tuple(observations.shape[1:])
        if given != team:
            raise InputError(
                f"a world of {team[0]} agents cannot be restarted with observations of shape {given}, "
                f"expected {team}: give those of its own team."
            )
        entries = [task.observation_names.index(name) for name in STATE_NAMES]
        state: NDArray[np.float64] = observations[..., entries].double().numpy()
        env = VectorEnv(task, len(observations))
        env.restart(self.seed, state[..., :2], state[..., 2:])
        return env
