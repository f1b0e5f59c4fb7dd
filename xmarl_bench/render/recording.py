"""Records one episode for drawing: played and explained as in scoring."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from xmarl_envs import TASKS, State, Task, VectorEnv
from xmarl_envs.heuristics import heuristic
from xmarl_envs.scene import Drawable, Picture, Track

from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer, fitted, run_explainer
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.policy import Policy
from xmarl_bench.render.ring import Ring
from xmarl_bench.reproducible import derived_seed, episode_seeds, one_thread
from xmarl_bench.rollout.cell import Cell
from xmarl_bench.rollout.episodes import chooser, initial_state
from xmarl_bench.rollout.reference_states import fit_states
from xmarl_bench.tasks.interface import TeamEpisodes, TeamTask, random_actions
from xmarl_bench.tasks.parallel_task import ParallelEpisodes

Floats = NDArray[np.float32]

WIDEST = 400  # pixels of a backdrop: a recording keeps one for every step
TEAMS = HEURISTIC, RANDOM = ("heuristic", "random")  # teams without a policy


@dataclass(frozen=True)
class Recording:
    """An episode of T steps and N agents."""

    task: TeamTask
    scenery: Drawable  # where agents stand and what is around them
    team: str  # the policy's name, HEURISTIC or RANDOM
    policy: Policy | None
    run_seed: int  # the seed of the run that plays this episode
    seed: int  # of the episode
    max_cycles: int | None  # after which it would have ended; None: the task's default
    track: Track
    observations: Floats  # (T, N, D + H), before each action: what agents saw and remembered
    success_rate: float  # as in `Episode`

    @property
    def reach(self) -> float:
        """The scale of all pictures, that of the last one."""
        return float(np.abs(self.track.scene().track).max()) + self.scenery.radius

    def explain(self, explainer: Explainer, cycles: Sequence[int]) -> NDArray[np.float32]:
        """(S, N, N): masks of the chosen steps; the same as in scoring if all steps are chosen.

        Raises InputError if the team has no policy, or if the explainer fails.
        """
        if self.policy is None:
            raise InputError(
                f"explainer {explainer.name!r} explains policies, but the team is {self.team!r}: "
                f"choose a policy, or leave the explainer out."
            )
        task, n_agents = self.task.name, self.task.n_agents
        states = partial(fit_states, self.policy, Cell(task, n_agents), self.max_cycles)
        explainer = fitted(explainer, self.policy, states, self.run_seed)
        explainer = replace(explainer, simulator=Simulator(task, n_agents, self.seed))
        seed = derived_seed("explainer", self.run_seed, explainer.name, self.seed)
        with one_thread():
            observations = torch.tensor(self.observations[np.asarray(cycles)])
            return np.asarray(run_explainer(explainer, self.policy, observations, seed).numpy())


def record(
    task: TeamTask,
    team: str,
    policy: Policy | None = None,
    *,
    seed: int = 0,
    episode: int = 0,
    max_cycles: int | None = None,
) -> Recording:
    """Play episode number `episode` of a scoring run with this seed.

    team: the policy's name; without a policy HEURISTIC or RANDOM. Raises InputError for an invalid seed or
    episode, and for another team without a policy.
    """
    if episode < 0:
        raise InputError(f"episode must be 0 or more, got {episode}: give the number of an episode.")
    if max_cycles is not None and max_cycles < 1:
        raise InputError(
            f"max_cycles must be at least 1, got {max_cycles}: choose a larger one, or leave it out."
        )
    environment_seed = episode_seeds(seed, episode + 1)[episode]
    if policy is not None:
        task = task.with_actions(policy.continuous_actions)
    choose = _choose(task, team, policy, environment_seed)
    env = task.vector_env(1, max_cycles)
    scenery = task if isinstance(task, Task) else Ring(task.name, task.n_agents)
    observation = env.reset([environment_seed])[0]
    memory = observation[:, :0] if policy is None else initial_state(policy, task.n_agents)
    track, observations = Track(_state(env, scenery), backdrop=_backdrop(env)), []
    with one_thread():
        while True:
            observations.append(np.concatenate([observation, memory], axis=-1))
            action, memory = choose(_state(env, scenery), observations[-1])
            step = env.step(action[None])
            track.add(_state(env, scenery), step, _backdrop(env))
            observation = step.observation[0]
            if step.terminated[0] or step.truncated[0]:
                break
    return Recording(
        task=task,
        scenery=scenery,
        team=team,
        policy=policy,
        run_seed=seed,
        seed=environment_seed,
        max_cycles=max_cycles,
        track=track,
        observations=np.stack(observations),
        success_rate=float(step.success[0].mean()),
    )


def _state(env: TeamEpisodes, scenery: Task | Ring) -> State:
    """Where the agents of the only episode are in a picture."""
    if isinstance(scenery, Ring):
        return scenery.state
    assert isinstance(env, VectorEnv)
    return env.state


def _backdrop(env: TeamEpisodes) -> Picture | None:
    """What a task of others draws itself, at most WIDEST pixels wide and high."""
    picture = env.picture(0) if isinstance(env, ParallelEpisodes) else None
    return None if picture is None else picture[(slice(None, None, -(-max(picture.shape) // WIDEST)),) * 2]


def _choose(
    task: TeamTask, team: str, policy: Policy | None, seed: int
) -> Callable[[State, Floats], tuple[Floats, Floats]]:
    """(state, observations (N, D + H)) -> actions (N, 2) or (N,), what is remembered next (N, H)."""
    if policy is not None:
        choose = chooser(policy)

        def act(_: State, observation: Floats) -> tuple[Floats, Floats]:
            action, memory = choose(observation[None])
            return action[0], memory[0]

        return act
    if team == HEURISTIC:
        if not isinstance(task, Task) or task.name not in TASKS:
            raise InputError(f"task {task.name!r} has no heuristic: choose {RANDOM!r}, or a policy.")
        return lambda state, seen: (heuristic(task, state)[0].astype(np.float32), seen[..., :0])
    if team == RANDOM:
        rng = np.random.default_rng([seed, 1])
        kind = np.float32 if task.continuous_actions else np.int64
        return lambda _, seen: (random_actions(task, 1, rng)[0].astype(kind), seen[..., :0])
    raise InputError(f"team {team!r} has no policy: give one, or choose {HEURISTIC!r} or {RANDOM!r}.")
