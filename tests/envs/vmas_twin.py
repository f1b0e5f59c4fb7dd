"""VMAS's navigation, passage and discovery with the same start and actions as ours, and its own rewards.

Changed are only: no lidar (blind agents have none), and discovery has one target, which does not come back.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
import vmas
from numpy.typing import NDArray
from vmas.scenarios import discovery, navigation, passage
from xmarl_envs import State

Floats = NDArray[np.float64]


class _Navigation(navigation.Scenario):  # type: ignore[misc]  # vmas is untyped
    def observation(self, agent: Any) -> torch.Tensor:
        return torch.cat([agent.state.pos, agent.state.vel, agent.state.pos - agent.goal.state.pos], dim=-1)


class _Discovery(discovery.Scenario):  # type: ignore[misc]
    def observation(self, agent: Any) -> torch.Tensor:
        near = torch.linalg.vector_norm(agent.state.pos - self._targets[0].state.pos, dim=-1) <= 0.35
        return torch.cat([agent.state.pos, agent.state.vel, near[:, None]], dim=-1)


class VmasTwin:
    """B episodes of one scenario of VMAS. Arrays have the same layout as ours: (B, N, 2)."""

    def __init__(self, name: str, n_agents: int, n_episodes: int, *, seed: int = 0) -> None:
        self.name = name
        scenario, options = {
            "blind_navigation_v0": (_Navigation, {"n_agents": n_agents}),
            "blind_passage_v0": (passage.Scenario, {}),
            "blind_discovery_v0": (
                _Discovery,
                {"n_agents": n_agents, "n_targets": 1, "targets_respawn": False, "shared_reward": True},
            ),
        }[name]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings of gym and torch
            self.env = vmas.make_env(scenario(), n_episodes, seed=seed, continuous_actions=True, **options)
        self.world, self.agents = self.env.world, self.env.agents
        assert len(self.agents) == n_agents

    @property
    def position(self) -> Floats:
        return _stack(agent.state.pos for agent in self.agents)

    @property
    def velocity(self) -> Floats:
        return _stack(agent.state.vel for agent in self.agents)

    @property
    def targets(self) -> Floats:
        if self.name == "blind_discovery_v0":
            return _stack(target.state.pos for target in self.env.scenario._targets)
        return _stack(agent.goal.state.pos for agent in self.agents)

    @property
    def gap(self) -> Floats:
        """(B, 2) the middle of the passage."""
        (removed,) = [box for box in self.world.landmarks[5:] if not box.collide]
        return np.asarray(removed.state.pos.double().numpy())

    def place(self, state: State) -> None:
        """Put all agents at rest where ours are, and start counting rewards there."""
        self.move(state.position)
        for agent in self.agents:
            agent.set_vel(torch.zeros(self.env.num_envs, 2), batch_index=None)
        if self.name == "blind_discovery_v0":
            self.env.scenario._targets[0].set_pos(_tensor(state.targets[:, 0]), batch_index=None)
            self.env.scenario.all_time_covered_targets[:] = False
            return
        for i, agent in enumerate(self.agents):
            agent.goal.set_pos(_tensor(state.targets[:, i]), batch_index=None)
            shaping = torch.linalg.vector_norm(agent.state.pos - agent.goal.state.pos, dim=1)
            if self.name == "blind_passage_v0":
                agent.global_shaping = 100 * shaping
            else:
                agent.pos_shaping = shaping
        if self.name == "blind_passage_v0":
            slots = -1 - 0.03333 + 0.103 * (0.5 + np.arange(20))
            gap = state.walls.mean(axis=1)[:, 0]
            boxes = sorted(self.world.landmarks[5:], key=lambda box: box.collide)  # the removed one first
            order = np.abs(slots - gap[:, None]).argsort(axis=1)  # the slot of the gap first
            for k, box in enumerate(boxes):
                x = slots[order[:, k]]
                box.set_pos(_tensor(np.stack([x, np.zeros_like(x)], axis=1)), batch_index=None)

    def move(self, position: Floats) -> None:
        for i, agent in enumerate(self.agents):
            agent.set_pos(_tensor(position[:, i]), batch_index=None)

    def step(self, action: NDArray[np.floating]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """(B, N, 2) actions -> observations (B, N, D), rewards (B, N), done (B,)."""
        observation, reward, done, _ = self.env.step([_tensor(action[:, i]) for i in range(len(self.agents))])
        return _stack(observation), _stack(reward), np.asarray(done.numpy())

    def judge(self) -> tuple[Floats, NDArray[np.bool_]]:
        """Rewards (B, N) and done (B,) at the current positions."""
        reward = _stack(self.env.scenario.reward(agent).clone() for agent in self.agents)
        return reward, np.asarray(self.env.scenario.done().numpy())

    def use_our_order(self) -> None:
        """Integrate like Chipmunk: move by the old velocity, then update it, with drag in both substeps.

        VMAS updates the velocity first, and all drag acts in the first of its one or two substeps.
        """
        world = self.world
        world._substeps, world._sub_dt = 2, world._dt / 2
        kept = (1 - world._drag) ** 0.5

        def integrate(entity: Any, substep: int) -> None:
            if entity.movable:
                moved = entity.state.pos + entity.state.vel * world._sub_dt
                for axis, reach in enumerate((world._x_semidim, world._y_semidim)):
                    if reach is not None:
                        moved[:, axis].clamp_(-reach, reach)
                force = world.forces_dict[entity] / entity.mass
                entity.state.pos, entity.state.vel = moved, entity.state.vel * kept + force * world._sub_dt

        world._integrate_state = integrate


def _stack(tensors: Any) -> Floats:
    return np.asarray(torch.stack(list(tensors), dim=1).double().numpy())


def _tensor(array: NDArray[np.floating]) -> torch.Tensor:
    return torch.tensor(array, dtype=torch.float32)
