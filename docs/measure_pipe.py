"""Prints the CPU time that a pipe adds, of all processes together: the figures of docs/security.md.

    .venv/bin/python docs/measure_pipe.py

The explainer returns ones, so the time is that of the pipe. A question is an episode of 100 timesteps, a step
of the 100 teams of a block that play on the explanation, or a step of 50 episodes. Both sides run in turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
import psutil
import torch
from torch import Tensor
from torch_geometric.nn import GATv2Conv
from xmarl_envs import BlindNavigation

from xmarl_bench import PolicyModule
from xmarl_bench.explain.adapters import as_explainer
from xmarl_bench.explain.explainer import run_explainer
from xmarl_bench.isolation.conversation import Isolation, end_strangers
from xmarl_bench.isolation.policies import isolate_policy
from xmarl_bench.isolation.tasks import ask_task
from xmarl_bench.origin.references import origin_of
from xmarl_bench.plugins.code_policies import open_module
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.plugins.registry import isolated
from xmarl_bench.policy import Policy, load_policy
from xmarl_bench.policy.teams_apart import step_teams
from xmarl_bench.tasks.interface import TeamTask
from xmarl_bench.tasks.sources import open_task

POLICIES = {3: "navigation-n3-residual-lambda0.1-seed0", 5: "navigation-n5-residual-lambda0.1-seed0"}
TURNS, TIMES, TIMESTEPS, EPISODES = 5, 40, 100, 50


class Farther(BlindNavigation):
    """A task of somebody else."""

    name = "farther_v0"


def ones(observations: Tensor) -> Tensor:
    return observations.new_ones(*observations.shape[:2], observations.shape[1])


def added(here: Callable[[], object], apart: Callable[[], object]) -> float:
    """The CPU seconds that a call takes apart, less those that it takes here."""
    seconds = [0.0, 0.0]
    for _ in range(TURNS):
        for side, call in enumerate((here, apart)):
            call()
            before = _cpu_seconds()
            for _ in range(TIMES):
                call()
            seconds[side] += _cpu_seconds() - before
    return (seconds[1] - seconds[0]) / (TURNS * TIMES)


def _cpu_seconds() -> float:
    """Of this process and of those that it has started."""
    others = [each.cpu_times() for each in psutil.Process().children(recursive=True)]
    return time.process_time() + float(sum(each.user + each.system for each in others))


def shown(what: str, n_agents: int, seconds: float, timesteps: int) -> None:
    each = f"{seconds / timesteps * 1e6:.0f} us a timestep"
    print(f"{what}, {n_agents} agents: {seconds * 1e3:.1f} ms a question, {each}", flush=True)


def starting(policy: Policy, observations: Tensor) -> None:
    for which in ("first", "second"):
        before = _cpu_seconds()
        run_explainer(isolated(as_explainer(ones)), policy, observations, 0)
        print(f"process of the {which} explainer: {_cpu_seconds() - before:.2f} s of CPU time", flush=True)
    end_strangers()


def explaining(policy: Policy, observations: Tensor, n_agents: int) -> None:
    explainer = as_explainer(ones)
    asked = (explainer, isolated(explainer))
    here, apart = (partial(run_explainer, each, policy, observations, 0) for each in asked)
    shown("explainer", n_agents, added(here, apart), TIMESTEPS)


def acting(observations: Tensor, n_agents: int) -> None:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = GATv2Conv(observations.shape[-1], 4, add_self_loops=False)
    module = PolicyModule("own", network, "blind_navigation_v0", n_agents)
    policies = open_module(module, origin_of(network))[0], isolate_policy(module, Isolation())[0]
    mask = torch.rand(TIMESTEPS, n_agents, n_agents)
    with torch.no_grad():
        here, apart = (partial(each.distribution, observations, mask) for each in policies)
        shown("policy, F(m)", n_agents, added(here, apart), TIMESTEPS)
        steps = [step_teams(each) for each in policies]
        acts = [partial(each, observations[:EPISODES], None) for each in steps]
        shown("policy, a step of the episodes", n_agents, added(*acts), EPISODES)


def playing(n_agents: int) -> None:
    def step(task: TeamTask) -> Callable[[], object]:
        env = task.vector_env(EPISODES, 10**6)
        env.reset(range(EPISODES))
        return partial(env.step, np.zeros((EPISODES, n_agents, task.action_width)))

    here = step(open_task(Farther).make(n_agents))
    apart = step(ask_task(Farther, Isolation()).make(n_agents))
    shown("task, a step of the episodes", n_agents, added(here, apart), EPISODES)


def main() -> None:
    torch.set_num_threads(1)
    for n_agents, name in POLICIES.items():
        policy, card = load_policy(find_policies()[name])
        observations = torch.randn(TIMESTEPS, n_agents, card.architecture.obs_dim)
        if n_agents == min(POLICIES):  # once: the server stays
            starting(policy, observations)
        explaining(policy, observations, n_agents)
        acting(observations, n_agents)
        playing(n_agents)
        end_strangers()


if __name__ == "__main__":
    main()
