"""Environments of others, and what is wrong with some, as functions of a team size."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import supersuit
from gymnasium import spaces
from mpe2 import simple_spread_v3
from pettingzoo import ParallelEnv
from pettingzoo.sisl import pursuit_v5
from xmarl_envs import BlindNavigation


def spread(n_agents: int) -> Any:
    """MPE2, five actions."""
    return simple_spread_v3.parallel_env(N=n_agents, continuous_actions=False)


def spread_drawn(n_agents: int) -> Any:
    return simple_spread_v3.parallel_env(N=n_agents, continuous_actions=False, render_mode="rgb_array")


def spread_continuous(n_agents: int) -> Any:
    """MPE2, a Box of [0, 1]."""
    return simple_spread_v3.parallel_env(N=n_agents, continuous_actions=True)


def pursuit(n_agents: int) -> Any:
    """PettingZoo SISL, whose observations are pictures, flattened."""
    env = supersuit.flatten_v0(pursuit_v5.parallel_env(n_pursuers=n_agents))
    env.max_cycles = 30
    return env


class Line(ParallelEnv[str, Any, Any]):  # type: ignore[misc]  # no py.typed in pettingzoo
    """Agents draw a number each, and see it beside the step; reward is the number."""

    metadata = {"name": "line"}  # noqa: RUF012
    max_cycles: Any = 6

    def __init__(self, n_agents: int) -> None:
        self.possible_agents = [f"agent_{k}" for k in range(n_agents)]
        self.agents: list[str] = []
        self.rng = np.random.default_rng(0)
        self.closed = False

    def close(self) -> None:
        self.closed = True

    def observation_space(self, agent: str) -> Any:
        return spaces.Box(-9.0, 99.0, (2,), np.float32)

    def action_space(self, agent: str) -> Any:
        return spaces.Box(np.array([0.0, -2.0], np.float32), np.array([1.0, 6.0], np.float32))

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        if seed is not None:
            self.rng = np.random.default_rng(seed)
        self.agents, self.cycle = list(self.possible_agents), 0
        self.place = self.rng.uniform(size=len(self.agents))
        return self.seen(), {agent: {} for agent in self.agents}

    def seen(self) -> dict[str, Any]:
        return {
            a: np.array([p, self.cycle], np.float32) for a, p in zip(self.agents, self.place, strict=True)
        }

    def infos(self) -> dict[str, dict[str, Any]]:
        return {agent: {} for agent in self.agents}

    def step(self, actions: Any) -> Any:
        self.actions = actions
        self.cycle += 1
        over = self.cycle >= self.max_cycles
        rewards = dict(zip(self.agents, self.place.tolist(), strict=True))
        result = (
            self.seen(),
            rewards,
            dict.fromkeys(self.agents, False),
            dict.fromkeys(self.agents, over),
            self.infos(),
        )
        if over:
            self.agents = []
        return result


class Told(Line):
    """Infos tell success at the end, and collisions at step 2 of the first agent."""

    def infos(self) -> dict[str, dict[str, Any]]:
        hit = self.cycle == 2
        infos: dict[str, dict[str, Any]] = {
            a: {"agent_collision": hit and a == "agent_0", "object_collision": False} for a in self.agents
        }
        if self.cycle == self.max_cycles:
            for k, agent in enumerate(self.agents):
                infos[agent]["is_success"] = k < 2
        return infos


class TellsWhatHappened(Line):
    """Infos hold a collision or a success only when there is one; half of the teams have none."""

    def infos(self) -> dict[str, dict[str, Any]]:
        lucky = self.place[0] > 0.5
        key = {2: "agent_collision", self.max_cycles: "is_success"}.get(self.cycle)
        return {a: {key: True} if key and lucky else {} for a in self.agents}


class ListsObservations(Line):
    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        seen, infos = super().reset(seed, options)
        return list(seen.values()), infos


class NoAgents(Line):
    def __init__(self, n_agents: int) -> None:
        super().__init__(n_agents)
        self.possible_agents = None  # type: ignore[assignment]


class ForgetsAgents(Line):
    def step(self, actions: Any) -> Any:
        told = super().step(actions)
        self.agents = None  # type: ignore[assignment]
        return told


class Leaves(Line):
    """The first agent leaves at step 3."""

    def step(self, actions: Any) -> Any:
        seen, rewards, terminated, truncated, infos = super().step(actions)
        if self.cycle == 3:
            terminated["agent_0"] = True
            self.agents = self.agents[1:]
        return seen, rewards, terminated, truncated, infos


class Unseeded(Line):
    """Ignores the seed of `reset`."""

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.rng = np.random.default_rng(time.perf_counter_ns())
        return super().reset()


class GlobalNumbers(Line):
    """Seeds numpy's global generator, and draws from it at every step, which another episode does too."""

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        np.random.seed(None if seed is None else seed % 2**32)  # noqa: NPY002
        return super().reset(seed)

    def step(self, actions: Any) -> Any:
        self.place = self.place + np.random.uniform(size=self.place.shape)  # noqa: NPY002
        return super().step(actions)


class EndsByTheClock(Line):
    """Every second environment ends a step later, after the same observations."""

    made = 0

    def __init__(self, n_agents: int) -> None:
        super().__init__(n_agents)
        type(self).made += 1
        self.ends = 2 + self.made % 2

    def step(self, actions: Any) -> Any:
        seen, rewards, terminated, truncated, infos = super().step(actions)
        if self.cycle == self.ends:
            truncated, self.agents = dict.fromkeys(truncated, True), []
        return seen, rewards, terminated, truncated, infos


class TellsArrays(Line):
    """An info holds an array where a truth value is asked for."""

    def infos(self) -> dict[str, dict[str, Any]]:
        return {agent: {"is_success": np.array([True, False])} for agent in self.agents}


class NoSeed(Line):
    """Its `reset` takes no seed."""

    def reset(self) -> Any:  # type: ignore[override]
        return super().reset()


class Unequal(Line):
    """The second agent sees more."""

    def observation_space(self, agent: str) -> Any:
        return spaces.Box(-9.0, 99.0, (3 if agent == "agent_1" else 2,), np.float32)


class Pictures(Line):
    """Observations are pictures."""

    def observation_space(self, agent: str) -> Any:
        return spaces.Box(0, 255, (8, 8, 3), np.uint8)


class Unbounded(Line):
    """Actions have no bounds."""

    def action_space(self, agent: str) -> Any:
        return spaces.Box(-np.inf, np.inf, (2,), np.float32)


class Buttons(Line):
    """Two discrete actions at once."""

    def action_space(self, agent: str) -> Any:
        return spaces.MultiDiscrete([2, 3])


class OldSpaces(Line):
    """Spaces are not of gymnasium."""

    def action_space(self, agent: str) -> Any:
        return {"low": 0, "high": 1}


class Endless(Line):
    """Does not say how many steps it has."""

    max_cycles = None


class Nan(Line):
    """Observes NaN."""

    def seen(self) -> dict[str, Any]:
        return {agent: np.array([np.nan, 0.0], np.float32) for agent in self.agents}


class Crashes(Line):
    def step(self, actions: Any) -> Any:
        raise KeyError("agent_7")


def one_too_many(n_agents: int) -> Line:
    return Line(n_agents + 1)


def no_environment(n_agents: int) -> list[int]:
    return [n_agents]


def fails(n_agents: int) -> None:
    raise RuntimeError("no licence")


def line(n_agents: int) -> Line:
    return Line(n_agents)


def happened(n_agents: int) -> TellsWhatHappened:
    return TellsWhatHappened(n_agents)


def told(n_agents: int) -> Told:
    return Told(n_agents)


class Farther(BlindNavigation):
    """A `Task` of one's own: half as large agents."""

    name = "farther_v0"
    radius = 0.05


class Torn(BlindNavigation):
    """Does not name all entries of its observations."""

    name = "torn_v0"
    observation_names = BlindNavigation.observation_names[:4]


class Broken(BlindNavigation):
    """Its rules fail."""

    name = "broken_v0"

    def judge(self, before: Any, state: Any, contacts: Any) -> Any:
        raise IndexError("no third goal")


class Impostor(BlindNavigation):
    """Keeps the name of a shipped task."""


BAD: dict[str, tuple[Callable[[int], Any], str]] = {
    "leaves": (Leaves, "agent_0 left at step 3, before the others"),
    "unseeded": (Unseeded, "does not repeat: .* differ at the start"),
    "global numbers": (GlobalNumbers, "does not repeat: .* differ after 1 steps"),
    "ends by the clock": (EndsByTheClock, "does not repeat: .* differ after 3 steps"),
    "tells arrays": (TellsArrays, r"failed in what step returns \(ValueError"),
    "no seed": (NoSeed, r"failed in reset\(seed=\d+\) \(TypeError"),
    "lists": (ListsObservations, r"failed in reset\(seed=\d+\) \(AttributeError"),
    "no agents": (NoAgents, "made a team of 0 agents, asked for 3"),
    "forgets agents": (ForgetsAgents, r"failed in what step returns \(TypeError"),
    "unequal": (Unequal, "has unequal agents .*observations of agent_0"),
    "pictures": (Pictures, "policies take vectors"),
    "unbounded": (Unbounded, "unbounded actions"),
    "buttons": (Buttons, "policies choose a Discrete"),
    "old spaces": (OldSpaces, "actions of agent_0 that are builtins.dict: give it spaces of gymnasium"),
    "endless": (Endless, "does not say how many steps"),
    "nan": (Nan, "agent_0 an observation with NaN or infinity"),
    "crashes": (Crashes, r"failed in step \(KeyError: 'agent_7'\)"),
    "one too many": (one_too_many, "made a team of 4 agents, asked for 3"),
    "no environment": (no_environment, "is a list: make its function return a PettingZoo ParallelEnv"),
    "fails": (fails, r"failed in making a team of 3 \(RuntimeError: no licence\)"),
}
