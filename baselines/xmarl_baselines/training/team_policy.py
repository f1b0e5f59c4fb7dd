"""Actor and centralised critic as one stable-baselines3 policy; the actor is what is scored."""

from __future__ import annotations

import json
import math
from typing import Any, NamedTuple

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor
from torch.distributions import Normal
from torch.nn import functional as F

from xmarl_bench.policy import ActionDistribution, Architecture, GraphPolicy
from xmarl_bench.policy.network import mlp

SATURATION = 1.0 - 1e-6  # actions are clamped to this before atanh; float32 is too coarse beyond it
SATURATED = 3.0  # tanh is 0.995 here: beyond it, larger means of raw actions change actions no more


class Evaluation(NamedTuple):
    """What a PPO update needs from a batch of B team-steps."""

    log_prob: Tensor  # (B, N)
    entropy: Tensor  # (), nats, of the TanhNormal, one sample per action
    attention_entropy: Tensor  # (), nats, mean over agents and batch
    saturation: Tensor  # (), mean square by which |loc| + deviations * scale passes SATURATED


class TeamPolicy(ActorCriticPolicy):
    """Observations (B, N, D) -> actions (B, N, 2), values (B, N), log-probabilities (B, N).

    `actor` is a GraphPolicy, the same for all agents; `critic` is an MLP on all observations of the team with
    one output per agent (MAPPO: Yu et al. 2022, "The Surprising Effectiveness of PPO in Cooperative MARL").
    """

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        *,
        architecture: dict[str, Any],
        critic: tuple[int, ...],
        **kwargs: Any,
    ) -> None:
        self._architecture, self._critic = architecture, critic
        super().__init__(observation_space, action_space, lr_schedule, **kwargs)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {
            **super()._get_constructor_parameters(),
            "architecture": self._architecture,
            "critic": self._critic,
        }

    def _build(self, lr_schedule: Schedule) -> None:
        assert isinstance(self.observation_space, spaces.Box)
        n_agents, obs_dim = self.observation_space.shape
        # Through JSON, because SB3 saves these arguments as JSON: tuples come back as lists.
        record = json.dumps({**self._architecture, "obs_dim": obs_dim})
        self.actor = GraphPolicy(Architecture.model_validate_json(record))
        widths = (n_agents * obs_dim, *self._critic)
        self.critic = mlp(widths, "tanh", n_agents)
        self.optimizer = torch.optim.Adam(self.parameters(), lr=lr_schedule(1), eps=1e-5)

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        distribution = self.actor.distribution(obs)
        raw = distribution.loc if deterministic else torch.normal(distribution.loc, distribution.scale)
        action = torch.tanh(raw).clamp(-SATURATION, SATURATION)
        return action, self.predict_values(obs), log_prob(distribution, action)

    def predict_values(self, obs: Tensor) -> Tensor:  # type: ignore[override]
        values: Tensor = self.critic(obs.flatten(start_dim=-2))
        return values

    def evaluate(self, obs: Tensor, action: Tensor, *, deviations: float) -> Evaluation:
        """Evaluate actions taken earlier for an update; values come from `predict_values`.

        deviations: of the raw action's standard deviations, how many count as saturation beside its mean.
        """
        prepared = self.actor.prepare(obs)
        distribution = self.actor.decode(prepared)
        normal = Normal(distribution.loc, distribution.scale, validate_args=False)
        # Differential entropy of the TanhNormal: the Normal's plus the mean log-slope of tanh. It has no
        # lower bound, so a negative weight on it drives actions into saturation.
        entropy = (normal.entropy() + _log_slope(normal.rsample())).sum(dim=-1).mean()
        attention = mean_attention_entropy(prepared.attention)
        reach = distribution.loc.abs() + deviations * distribution.scale
        saturation = F.relu(reach - SATURATED).square().mean()
        return Evaluation(log_prob(distribution, action), entropy, attention, saturation)

    def _predict(self, observation: Tensor, deterministic: bool = False) -> Tensor:  # type: ignore[override]
        action: Tensor = self(observation, deterministic)[0]
        return action


def mean_attention_entropy(attention: Tensor) -> Tensor:
    """(..., N, N), rows sum to 1 -> (): mean entropy of a row in nats, with a finite gradient at 0."""
    entropy: Tensor = torch.special.entr(attention.clamp_min(1e-20)).sum(dim=-1).mean()
    return entropy


def log_prob(distribution: ActionDistribution, action: Tensor) -> Tensor:
    """(..., N): log-density of actions in (-1, 1) under the TanhNormal, summed over action entries."""
    raw = torch.atanh(action)
    normal = Normal(distribution.loc, distribution.scale, validate_args=False)
    density: Tensor = normal.log_prob(raw) - _log_slope(raw)
    return density.sum(dim=-1)


def _log_slope(raw: Tensor) -> Tensor:
    """log(1 - tanh(raw)^2), without cancellation."""
    slope: Tensor = 2.0 * (math.log(2.0) - raw - F.softplus(-2.0 * raw))
    return slope
