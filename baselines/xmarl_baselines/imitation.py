"""Warm start by imitation: the actor learns to act as the task's heuristic does, from what the team observes.

DAgger (Ross, Gordon and Bagnell, AISTATS 2011): teams are driven by the heuristic at first, by the actor more
and more, and the heuristic says at every state what it would have done. It may see everything; the actor sees
the team's observations through its graph layer, so it learns as much of the heuristic as these can tell.
The loss is the squared difference of actions plus, as in training, a multiple of the attention entropy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from xmarl_envs import State, Task, VectorEnv
from xmarl_envs.heuristics import heuristic
from xmarl_envs.heuristics.ladder import ladder
from xmarl_envs.heuristics.wide_berth import wide_berth
from xmarl_envs.task import Floats

from xmarl_baselines.schedules import ramp
from xmarl_baselines.team_policy import mean_attention_entropy
from xmarl_baselines.team_vec_env import training_seeds
from xmarl_bench.errors import InputError
from xmarl_bench.policy import GraphPolicy

# The task's own heuristic, or the smooth one that was made to be imitated: navigation's, passage's.
TEACHERS: dict[str, Callable[[Any, State], Floats]] = {
    "heuristic": heuristic,
    "wide_berth": wide_berth,
    "ladder": ladder,
}
ROUND = 25  # team-steps of every team between two rounds of gradient steps


@dataclass(frozen=True)
class Imitation:
    """How long and how. A round is ROUND steps of `n_envs` teams, then `updates` gradient steps."""

    rounds: int
    teacher: str = "heuristic"  # of TEACHERS
    n_envs: int = 200
    updates: int = 20
    batch_size: int = 1000  # team-steps
    learning_rate: float = 1e-3  # falls linearly to a twentieth
    attention_rate: float = 1.0  # relative learning rate of whom an agent attends to
    memory: int = 300_000  # team-steps; the oldest are forgotten
    guided: float = 0.33  # fraction of the rounds over which the heuristic hands over to the actor
    attention_scale: float = 10.0  # lambda is multiplied by this: the loss is of another size than PPO's
    attention_start: float = 0.3  # fraction of the rounds without the attention-entropy term; lambda then ...
    attention_ramp: float = 0.4  # ... grows from 0 over this fraction: at once it would silence the team
    noise: float = 0.15  # standard deviation added to the actions of half of the teams at each step
    scale: float = 0.3  # of the actor's action distribution at the end: how much it explores afterwards

    def __post_init__(self) -> None:
        if self.teacher not in TEACHERS:
            *names, last = TEACHERS
            raise InputError(f"teacher must be {', '.join(names)} or {last}, got {self.teacher!r}.")

    @property
    def frames(self) -> int:
        """Team-steps played in all rounds."""
        return self.rounds * self.frames_per_round

    @property
    def frames_per_round(self) -> int:
        return ROUND * self.n_envs

    def shows(self, task: Task, state: State) -> Floats:
        """(B, N, 2) actions in [-1, 1] to be imitated."""
        return TEACHERS[self.teacher](task, state)


def imitate(
    actor: GraphPolicy,
    task: Task,
    how: Imitation,
    *,
    seed: int,
    attention_entropy: float = 0.0,
    report: Callable[[int, dict[str, float]], None] | None = None,
) -> None:
    """Train `actor` in place. `report` gets the rounds done and what was measured, after each.

    Sampling draws from `seed` alone; the actor's own initial weights are the caller's.
    """
    rng = np.random.default_rng([seed, 1])  # not the numbers that training draws from `seed`
    optimizer = torch.optim.Adam(_groups(actor, how.attention_rate), how.learning_rate)
    teams = _Teams(task, how, rng)
    for done in range(how.rounds):
        teams.play(actor, guided=max(0.0, 1.0 - done / (how.guided * how.rounds)))
        for group in optimizer.param_groups:
            group["lr"] = group["rate"] * how.learning_rate * max(0.05, 1.0 - done / how.rounds)
        grown = ramp(done / how.rounds, how.attention_start, how.attention_ramp)
        weight = attention_entropy * how.attention_scale * grown
        measured = [
            _update(actor, optimizer, *teams.sample(how.batch_size), how.scale, weight)
            for _ in range(how.updates)
        ]
        if report is not None:
            report(done + 1, {name: float(np.mean([m[name] for m in measured])) for name in measured[0]})


def _groups(actor: GraphPolicy, attention_rate: float) -> list[dict[str, Any]]:
    """Parameters with their relative learning rates: of the attention's weights, and of all others."""
    attention = [actor.gat.att, *actor.gat.lin_r.parameters()]
    known = {id(parameter) for parameter in attention}
    others = [parameter for parameter in actor.parameters() if id(parameter) not in known]
    return [{"params": others, "rate": 1.0}, {"params": attention, "rate": attention_rate}]


def _update(
    actor: GraphPolicy,
    optimizer: torch.optim.Optimizer,
    observation: Tensor,
    shown: Tensor,
    scale: float,
    attention_entropy: float,
) -> dict[str, float]:
    prepared = actor.prepare(observation)
    distribution = actor.decode(prepared)
    error = (torch.tanh(distribution.loc) - shown).square().mean()
    spread = (distribution.scale.log() - np.log(scale)).square().mean()
    entropy = mean_attention_entropy(prepared.attention)
    optimizer.zero_grad()
    (error + 0.01 * spread + attention_entropy * entropy).backward()
    torch.nn.utils.clip_grad_norm_(actor.parameters(), 1.0)
    optimizer.step()
    return {"imitation_error": error.item(), "attention_entropy": entropy.item()}


class _Teams:
    """Teams that play on and on, and the memory of what they saw and were shown."""

    def __init__(self, task: Task, how: Imitation, rng: np.random.Generator) -> None:
        self._task, self._how, self._rng = task, how, rng
        self._env = VectorEnv(task, how.n_envs, copies_per_space=64)
        self._observation = self._env.reset(training_seeds(rng, how.n_envs))
        self._env.cycles[:] = rng.integers(0, self._env.max_cycles, how.n_envs)  # not all ending at once
        slots = how.memory // how.n_envs
        self._seen = torch.zeros(slots, how.n_envs, task.n_agents, task.obs_dim)
        self._shown = torch.zeros(slots, how.n_envs, task.n_agents, 2)
        self._stored = 0

    def play(self, actor: GraphPolicy, guided: float) -> None:
        """ROUND steps; a team follows the heuristic for the round with probability `guided`."""
        n_envs, rng = self._how.n_envs, self._rng
        follows = rng.random(n_envs) < guided
        for _ in range(ROUND):
            shown = self._how.shows(self._task, self._env.state)
            seen = torch.from_numpy(self._observation)
            slot = self._stored % len(self._seen)
            self._seen[slot], self._shown[slot] = seen, torch.from_numpy(shown)
            self._stored += 1
            with torch.no_grad():
                own = torch.tanh(actor.distribution(seen).loc).numpy()
            action = np.where(follows[:, None, None], shown, own)
            shaken = rng.random((n_envs, 1, 1)) < 0.5
            step = self._env.step(action + self._how.noise * shaken * rng.standard_normal(action.shape))
            self._observation = step.observation
            ended = np.flatnonzero(step.terminated | step.truncated)
            if ended.size:
                self._observation = self._env.reset(training_seeds(rng, ended.size), ended)

    def sample(self, batch_size: int) -> tuple[Tensor, Tensor]:
        """(batch, N, D) observations and (batch, N, 2) actions shown."""
        filled = min(self._stored, len(self._seen)) * self._how.n_envs
        index = torch.from_numpy(self._rng.integers(0, filled, batch_size))
        return self._seen.flatten(0, 1)[index], self._shown.flatten(0, 1)[index]
