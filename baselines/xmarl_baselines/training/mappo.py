"""MAPPO with attention-entropy minimisation, on stable-baselines3's PPO.

Papers: Yu et al. 2022, "The Surprising Effectiveness of PPO in Cooperative Multi-Agent Games" (centralised
critic, parameter sharing); Kailas et al. (ICML 2025), equation 1 (the attention-entropy term).

Departures from SB3's PPO, all in `train`: ratios and advantages are per agent, the value loss is smooth L1,
gradients of actor and critic are clipped separately (as in TorchRL, so that neither scales the other down),
advantages are normalised over the rollout, and lambda * H(alpha) and a penalty of saturated actions are added
to the loss. `learn`, `collect_rollouts`, `save`, `load`, the logger and callbacks are SB3's.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, ConvertCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import MaybeCallback
from stable_baselines3.common.utils import explained_variance
from torch import Tensor
from torch.nn import functional as F

from xmarl_baselines.training.team_buffer import TeamRolloutBuffer, TeamSamples
from xmarl_baselines.training.team_policy import TeamPolicy

# Of a new probability to that when the action was taken. The ratio of a saturated action can pass float32's
# largest number, which would make every weight NaN.
MAX_LOG_RATIO = 20.0
AGENTS_AT_ONCE = 3072  # rows per part of a minibatch: the fastest of 384 to 16384 on one core


class IterationCallback(BaseCallback):
    """A callback of MAPPO that acts before or after an iteration's steps."""

    model: MAPPO

    def _on_step(self) -> bool:
        return True


class _TruncationBootstrap(IterationCallback):
    """Adds gamma * V(last observation) to the rewards of truncated teams.

    SB3 does this in `collect_rollouts` for one reward per environment (if `terminal_observation` is given).
    That line raises for rewards per agent, so the environment gives `truncated_observation` instead.
    """

    def _on_step(self) -> bool:
        infos: list[dict[str, Any]] = self.locals["infos"]
        which = [k for k, info in enumerate(infos) if info.get("TimeLimit.truncated")]
        if which:
            last = torch.from_numpy(np.stack([infos[k]["truncated_observation"] for k in which]))
            with torch.no_grad():
                values = self.model.policy.predict_values(last.to(self.model.device))
            self.locals["rewards"][which] += self.model.gamma * values.cpu().numpy()
        return True


class MAPPO(PPO):
    """Multi-agent PPO on a `TeamVecEnv`.

    Args beyond SB3's PPO:
        attention_entropy: lambda, the weight of the mean attention entropy (nats) in the loss.
        attention_ramp: fraction of training over which lambda grows linearly from 0.
        attention_start: fraction of training before which lambda is 0.
        saturation_penalty: weight in the loss of the mean square by which raw actions pass SATURATED: their
            means plus `saturation_deviations` standard deviations. Without it means or deviations can grow
            without end, until ratios of probabilities are noise.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"TeamPolicy": TeamPolicy}
    policy: TeamPolicy
    rollout_buffer: TeamRolloutBuffer

    def __init__(
        self,
        *args: Any,
        attention_entropy: float = 0.0,
        attention_ramp: float = 0.0,
        attention_start: float = 0.0,
        saturation_penalty: float = 0.0,
        saturation_deviations: float = 0.0,
        **kwargs: Any,
    ) -> None:
        self.attention_entropy = attention_entropy
        self.attention_ramp = attention_ramp
        self.attention_start = attention_start
        self.saturation_penalty = saturation_penalty
        self.saturation_deviations = saturation_deviations
        kwargs.setdefault("rollout_buffer_class", TeamRolloutBuffer)
        super().__init__(*args, **kwargs)

    def attention_weight(self) -> float:
        """lambda at the present moment of training."""
        since = 1.0 - self._current_progress_remaining - self.attention_start
        if since < 0:
            return 0.0
        return self.attention_entropy * (
            min(1.0, since / self.attention_ramp) if self.attention_ramp else 1.0
        )

    def train(self) -> None:
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        log: defaultdict[str, list[float]] = defaultdict(list)
        for _ in range(self.n_epochs):
            for samples in self.rollout_buffer.minibatches(self.batch_size, self.normalize_advantage):
                for name, value in self._update(samples).items():
                    log[name].append(value)
            self._n_updates += 1
        for name, values in log.items():
            self.logger.record(f"train/{name}", float(np.mean(values)))
        buffer = self.rollout_buffer
        variance = explained_variance(buffer.values.flatten(), buffer.returns.flatten())
        self.logger.record("train/explained_variance", float(variance))
        self.logger.record("train/attention_weight", self.attention_weight())
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        for key in ("is_success", "no_agent_collision"):
            rows = [row[key] for row in self.ep_info_buffer or [] if key in row]
            if rows:
                self.logger.record(f"rollout/{key}", float(np.mean(rows)))

    def _update(self, samples: TeamSamples) -> dict[str, float]:
        """One gradient step on a minibatch; returns its losses and statistics by name.

        Gradients are summed over parts of the minibatch whose activations stay in the processor's cache.
        """
        policy = self.policy
        policy.optimizer.zero_grad()
        n_steps, n_agents = samples.advantages.shape
        width = max(1, AGENTS_AT_ONCE // n_agents)
        measured: defaultdict[str, float] = defaultdict(float)
        for first in range(0, n_steps, width):
            part = TeamSamples(*(array[first : first + width] for array in samples))
            share = len(part.advantages) / n_steps
            loss, measures = self._loss(part)
            (share * loss).backward()
            for name, value in measures.items():
                measured[name] += share * value
        torch.nn.utils.clip_grad_norm_(policy.actor.parameters(), self.max_grad_norm)
        torch.nn.utils.clip_grad_norm_(policy.critic.parameters(), self.max_grad_norm)
        policy.optimizer.step()
        return measured

    def _loss(self, samples: TeamSamples) -> tuple[Tensor, dict[str, float]]:
        policy = self.policy
        clip = self.clip_range(self._current_progress_remaining)  # type: ignore[operator]
        evaluation = policy.evaluate(
            samples.observations, samples.actions, deviations=self.saturation_deviations
        )
        log_ratio = evaluation.log_prob - samples.log_probs
        ratio = log_ratio.clamp(max=MAX_LOG_RATIO).exp()
        surrogate = torch.min(
            samples.advantages * ratio, samples.advantages * ratio.clamp(1.0 - clip, 1.0 + clip)
        )
        policy_loss = -surrogate.mean()
        value_loss = F.smooth_l1_loss(policy.predict_values(samples.observations), samples.returns)
        loss = (
            policy_loss
            + self.vf_coef * value_loss
            - self.ent_coef * evaluation.entropy
            + self.attention_weight() * evaluation.attention_entropy
            + self.saturation_penalty * evaluation.saturation
        )
        return loss, {
            "policy_loss": policy_loss.item(),
            "value_loss": value_loss.item(),
            "entropy": evaluation.entropy.item(),
            "attention_entropy": evaluation.attention_entropy.item(),
            "saturation": evaluation.saturation.item(),
            "approx_kl": (ratio - 1.0 - log_ratio).mean().item(),
            "clip_fraction": ((ratio - 1.0).abs() > clip).float().mean().item(),
        }

    def _init_callback(self, callback: MaybeCallback, progress_bar: bool = False) -> BaseCallback:
        given = callback if isinstance(callback, list) else [] if callback is None else [callback]
        converted = [c if isinstance(c, BaseCallback) else ConvertCallback(c) for c in given]
        return super()._init_callback([_TruncationBootstrap(), *converted], progress_bar)
