"""SB3's rollout buffer with rewards, values and advantages per agent."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.buffers import RolloutBuffer
from torch import Tensor


class TeamSamples(NamedTuple):
    """A minibatch of B team-steps."""

    observations: Tensor  # (B, N, D)
    actions: Tensor  # (B, N, 2)
    log_probs: Tensor  # (B, N), when the action was taken
    advantages: Tensor  # (B, N)
    returns: Tensor  # (B, N)


class TeamRolloutBuffer(RolloutBuffer):
    """T steps of E teams of N agents: per-agent quantities are (T, E, N)."""

    def reset(self) -> None:
        n_agents = self.obs_shape[0]
        steps = (self.buffer_size, self.n_envs)
        self.observations = np.zeros((*steps, *self.obs_shape), np.float32)
        self.actions = np.zeros((*steps, n_agents, self.action_dim // n_agents), np.float32)
        for name in ("rewards", "values", "log_probs", "advantages", "returns"):
            setattr(self, name, np.zeros((*steps, n_agents), np.float32))
        self.episode_starts = np.zeros(steps, np.float32)
        self.pos, self.full, self.generator_ready = 0, False, False

    def add(
        self,
        obs: np.ndarray[Any, Any],
        action: np.ndarray[Any, Any],
        reward: np.ndarray[Any, Any],
        episode_start: np.ndarray[Any, Any],
        value: Tensor,
        log_prob: Tensor,
    ) -> None:
        self.observations[self.pos] = obs
        self.actions[self.pos] = action
        self.rewards[self.pos] = reward
        self.episode_starts[self.pos] = episode_start
        self.values[self.pos] = value.cpu().numpy()
        self.log_probs[self.pos] = log_prob.cpu().numpy()
        self.pos += 1
        self.full = self.pos == self.buffer_size

    def compute_returns_and_advantage(self, last_values: Tensor, dones: np.ndarray[Any, Any]) -> None:
        """GAE(lambda), Schulman et al. 2016, for each agent with its own value."""
        goes_on = np.concatenate([1.0 - self.episode_starts[1:], 1.0 - dones[None].astype(np.float32)])[
            ..., None
        ]
        next_values = np.concatenate([self.values[1:], last_values.cpu().numpy()[None]])
        delta = self.rewards + self.gamma * next_values * goes_on - self.values
        advantage = np.zeros_like(delta[0])
        for t in reversed(range(self.buffer_size)):
            advantage = delta[t] + self.gamma * self.gae_lambda * goes_on[t] * advantage
            self.advantages[t] = advantage
        self.returns = self.advantages + self.values

    def minibatches(self, batch_size: int, normalize_advantage: bool) -> Iterator[TeamSamples]:
        """One pass in a random order; advantages normalised over the whole buffer if asked."""
        advantages = self.advantages
        if normalize_advantage:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        flat = [
            torch.from_numpy(array.reshape(-1, *array.shape[2:]))
            for array in (self.observations, self.actions, self.log_probs, advantages, self.returns)
        ]
        for index in torch.randperm(self.buffer_size * self.n_envs).split(batch_size):
            yield TeamSamples(*(array[index].to(self.device) for array in flat))
