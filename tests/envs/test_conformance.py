"""Our tasks pass `check_task`, and it detects a violation of each of its promises."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pytest
from gymnasium import spaces
from mpe2 import simple_spread_v3
from numpy.typing import NDArray
from pettingzoo import ParallelEnv
from xmarl_envs import (
    TASKS,
    BlindNavigation,
    Layout,
    Outcome,
    State,
    Task,
    TaskParallelEnv,
    VectorEnv,
    make_task,
)
from xmarl_envs.task import Floats
from xmarl_envs.testing import check_task
from xmarl_envs.trajectory import play

pytestmark = pytest.mark.slow

RETURN = tuple[
    dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
]  # of `step`


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("blind_navigation_v0", {"n_agents": 5}),
        ("blind_passage_v0", {"n_agents": 5, "shared_reward": True, "seed": 3}),
        ("blind_passage_v0", {"n_agents": 1}),
        ("blind_discovery_v0", {"n_agents": 5}),
        ("blind_navigation_v0", {"n_agents": 3, "continuous_actions": False}),
        ("blind_passage_v0", {"n_agents": 3, "continuous_actions": False}),
        ("blind_discovery_v0", {"n_agents": 3, "continuous_actions": False}),
    ],
)
def test_our_tasks_conform(name: str, options: dict[str, Any]) -> None:
    check_task(TASKS[name], **options)


@pytest.mark.parametrize("name", TASKS)
def test_the_compared_episodes_have_contacts(name: str) -> None:
    assert play(VectorEnv(make_task(name, 5)), seed=0)[1] > 20


class Pursuit(ParallelEnv[str, NDArray[np.float32], int]):  # type: ignore[misc]  # no py.typed in pettingzoo
    """A third-party environment that is not a `Task`: two agents on a line, one fleeing."""

    metadata: ClassVar[dict[str, Any]] = {"name": "pursuit", "render_modes": ["human", "rgb_array"]}

    def __init__(self, max_cycles: int = 40, render_mode: str | None = None) -> None:
        self.possible_agents = ["hunter_0", "prey_0"]
        self.agents: list[str] = []
        self.render_mode, self.max_cycles = render_mode, max_cycles
        self.state_space = spaces.Box(-100, 100, (2,), np.float32)
        self.observation_spaces = {agent: self.state_space for agent in self.possible_agents}
        self.action_spaces = {agent: spaces.Discrete(3) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, Any]]]:
        self.rng = np.random.default_rng(seed)
        self.place = self.rng.uniform(1, 50, 2) * (-1, 1)
        self.cycle, self.agents = 0, list(self.possible_agents)
        return dict.fromkeys(self.agents, self.state()), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> RETURN:
        self.cycle += 1
        self.place = np.clip(self.place + [actions[agent] - 1 for agent in self.agents], -100, 100)
        caught = bool(abs(self.place[0] - self.place[1]) < 1)
        agents, over = self.agents, self.cycle >= self.max_cycles
        if caught or over:
            self.agents = []
        return (
            dict.fromkeys(agents, self.state()),
            dict.fromkeys(agents, float(caught)),
            dict.fromkeys(agents, caught),
            dict.fromkeys(agents, over and not caught),
            {agent: {} for agent in agents},
        )

    def state(self) -> NDArray[np.float32]:
        return np.asarray(self.place, dtype=np.float32)

    def render(self) -> NDArray[np.uint8] | None:
        return None if self.render_mode == "human" else np.zeros((4, 4, 3), np.uint8)


def test_a_third_party_environment_conforms() -> None:
    check_task(Pursuit, max_cycles=30)


class EndsAtOnceMostly(Pursuit):
    """In two of three episodes the prey is caught in the first step, which breaks no promise."""

    def reset(self, *args: Any, **kwargs: Any) -> Any:
        result = super().reset(*args, **kwargs)
        self.lucky = self.rng.random() > 1 / 3
        return result

    def step(self, actions: dict[str, int]) -> RETURN:
        if self.lucky:
            self.place = np.ones(2)
        return super().step(dict.fromkeys(actions, 1) if self.lucky else actions)


def test_episodes_may_end_before_max_cycles() -> None:
    check_task(EndsAtOnceMostly, seed=2, max_cycles=30)


def test_a_published_environment_conforms() -> None:
    check_task(simple_spread_v3.parallel_env, N=2, max_cycles=25)


@dataclass(frozen=True)
class Short(BlindNavigation):
    name: ClassVar[str] = "short_v0"
    default_max_cycles: ClassVar[int] = 60
    max_agents: ClassVar[int] = 4


def test_the_task_that_is_broken_below_conforms() -> None:
    check_task(Short)
    check_task(partial(Broken, Short()))


class SeesOthers(Short):
    def observe(self, state: State) -> Floats:
        seen = super().observe(state)
        seen[..., 0] += 1e-3 * state.position[..., 0].mean(axis=-1, keepdims=True)
        return seen


class NormalisesOverTheBatch(Short):
    def judge(self, before: Floats, state: State, contacts: Floats) -> Outcome:
        outcome = super().judge(before, state, contacts)
        return outcome._replace(reward=outcome.reward - outcome.reward.mean(axis=0))


class TakesTheLogarithmOfSpeed(Short):
    def observe(self, state: State) -> Floats:
        with np.errstate(invalid="ignore"):
            state = state._replace(velocity=np.log(1 - state.velocity / 100))
        return super().observe(state)


class AlwaysStartsAlike(Short):
    def spawn(self, rng: np.random.Generator) -> Layout:
        return super().spawn(np.random.default_rng(0))


class DrawsFromAHash(Short):
    def spawn(self, rng: np.random.Generator) -> Layout:
        return super().spawn(np.random.default_rng(abs(hash(str(rng.integers(10**6))))))


class CountsItsEpisodes(Short):
    def spawn(self, rng: np.random.Generator) -> Layout:
        episode = self.__dict__.get("episode", 0)
        object.__setattr__(self, "episode", episode + 1)
        layout = super().spawn(rng)
        return layout._replace(agents=layout.agents + 1e-3 * episode)


class SharesItsDraws(Short):
    scale: ClassVar[dict[str, float]] = {}  # drawn in each episode, and shared by all

    def spawn(self, rng: np.random.Generator) -> Layout:
        self.scale["reward"] = rng.uniform(1, 2)
        return super().spawn(rng)

    def judge(self, before: Floats, state: State, contacts: Floats) -> Outcome:
        outcome = super().judge(before, state, contacts)
        return outcome._replace(reward=outcome.reward * self.scale["reward"])


class NeedsThreeAtMost(Short):
    def spawn(self, rng: np.random.Generator) -> Layout:
        if self.n_agents > 3:
            raise RuntimeError("no room for four")
        return super().spawn(rng)


class TakesAnyTeam(Short):
    def __post_init__(self) -> None:
        pass


class RefusesWithoutSayingWhy(Short):
    def __post_init__(self) -> None:
        if self.n_agents not in range(1, 5):
            raise ValueError("bad team")


@pytest.mark.parametrize(
    ("task", "promise"),
    [
        (SeesOthers, r"no agent observes another: moving agent 0 changed what agents \[1, 2\] observe\."),
        (
            NormalisesOverTheBatch,
            "an episode does not depend on its neighbours in a batch: episode 1 of 2 differs from the same "
            r"episode alone\.",
        ),
        (
            TakesTheLogarithmOfSpeed,
            "its spaces contain every observation at any speed and place: that of agent_. at 1000 m/s is not",
        ),
        (AlwaysStartsAlike, "another seed gives another episode: four seeds gave 1"),
        (DrawsFromAHash, "same episode in every process: it differs in a process with PYTHONHASHSEED=0"),
        (CountsItsEpisodes, "same episode whatever was played before: it differs after two other episodes"),
        (SharesItsDraws, "same episode whatever is played beside it: it differs while a second environment"),
        (NeedsThreeAtMost, "it plays with any team of 1 to 4: RuntimeError: no room for four"),
        (TakesAnyTeam, "it refuses a team of 0, saying so in a ValueError: "),
        (
            RefusesWithoutSayingWhy,
            "it refuses a team of 0, saying so in a ValueError: the error only says 'bad",
        ),
    ],
    ids=lambda value: value.__name__ if isinstance(value, type) else "",
)
def test_check_task_names_the_promise_that_a_task_breaks(task: type[Task], promise: str) -> None:
    with pytest.raises(AssertionError, match=f"^short_v0 breaks the promise that .*{promise}"):
        check_task(task)


class Broken(TaskParallelEnv):
    """A valid environment; each subclass breaks one promise."""

    def __init__(self, task: Task, max_cycles: int | None = None, render_mode: str | None = None) -> None:
        super().__init__(task, max_cycles, render_mode)
        self.cycle = 0

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        self.cycle = 0
        return super().reset(seed, options)

    def step(self, actions: dict[str, Any]) -> RETURN:
        self.cycle += 1
        return self.breaking(super().step(actions))

    def breaking(self, result: RETURN) -> RETURN:
        return result


class LeavesAnAgentOut(Broken):
    def breaking(self, result: RETURN) -> RETURN:
        result[1].pop("agent_1", None)
        return result


class ChangesItsType(Broken):
    def breaking(self, result: RETURN) -> RETURN:
        return ({agent: seen.astype(np.float64) for agent, seen in result[0].items()}, *result[1:])


class IgnoresItsSeed(Broken):
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        return super().reset(None, options)


class ThrowsDiceLater(Broken):
    """PettingZoo's parallel_seed_test compares only one step."""

    def breaking(self, result: RETURN) -> RETURN:
        if self.cycle > 5:
            return (result[0], {agent: np.random.default_rng().random() for agent in result[1]}, *result[2:])
        return result


class NeverEnds(Broken):
    def __init__(self, task: Task, max_cycles: int | None = None, render_mode: str | None = None) -> None:
        super().__init__(task, 50, render_mode)


class HasAWideState(Broken):
    def state(self) -> NDArray[np.float32]:
        return np.concatenate([super().state(), [0.0]], dtype=np.float32)


class PaintsInFloats(Broken):
    def render(self, mask: Any = None) -> Any:
        picture = super().render(mask)
        return None if picture is None else picture / 255


class ThinksItIsSlow(Broken):
    """An agent at full thrust reaches 0.373 m/s; pushed at random it stays below 0.3."""

    def __init__(self, task: Task, max_cycles: int | None = None, render_mode: str | None = None) -> None:
        super().__init__(task, max_cycles, render_mode)
        limit = np.array([np.inf, np.inf, 0.35, 0.35, np.inf, np.inf], np.float32)
        box = spaces.Box(-limit, limit, dtype=np.float32)
        self.observation_spaces = {agent: box for agent in self.possible_agents}


class PaysWithoutLimit(Broken):
    def breaking(self, result: RETURN) -> RETURN:
        if self.cycle == 59:
            return (result[0], dict.fromkeys(result[1], float("inf")), *result[2:])
        return result


class IsMovedByTheBrush(Broken):
    drawn = 0

    def render(self, mask: Any = None) -> Any:
        self.drawn += 1
        return super().render(mask)

    def breaking(self, result: RETURN) -> RETURN:
        return (result[0], {agent: pay + self.drawn for agent, pay in result[1].items()}, *result[2:])


@pytest.mark.parametrize(
    ("env", "promise"),
    [
        (
            LeavesAnAgentOut,
            "it passes PettingZoo's parallel_api_test without a warning: UserWarning: Live agent",
        ),
        (ChangesItsType, "it passes PettingZoo's api_test when stepped turn by turn without a warning: "),
        (
            IgnoresItsSeed,
            "it passes PettingZoo's parallel_seed_test without a warning: Incorrect observations",
        ),
        (ThrowsDiceLater, "it passes PettingZoo's seed_test without a warning: Incorrect reward"),
        (NeverEnds, "it passes PettingZoo's max_cycles_test without a warning: assert "),
        (
            HasAWideState,
            "it passes PettingZoo's state_test without a warning: Environment's state is outside",
        ),
        (PaintsInFloats, "it passes PettingZoo's render_test without a warning: rgb_array mode must return"),
        (
            ThinksItIsSlow,
            "its spaces contain every observation: that of agent_. after .* cycles is not in Box",
        ),
        (PaysWithoutLimit, "its spaces contain every observation: the reward of agent_0 in cycle 59 is inf"),
        (IsMovedByTheBrush, "same episode whether it is drawn or not: it differs when it is rendered"),
    ],
    ids=lambda value: value.__name__ if isinstance(value, type) else "",
)
def test_check_task_names_the_promise_that_an_environment_breaks(env: type[Broken], promise: str) -> None:
    with pytest.raises(AssertionError, match=f"^short_v0 breaks the promise that .*{promise}"):
        check_task(partial(env, Short()))


def test_check_task_refuses_what_is_not_an_environment() -> None:
    with pytest.raises(
        AssertionError, match=r"^dict breaks the promise that it can be made and is a Petting"
    ):
        check_task(dict)
