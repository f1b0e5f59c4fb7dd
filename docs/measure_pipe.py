"""Prints what asking an explainer over a pipe adds to a timestep: the figures of docs/security.md.

    .venv/bin/python docs/measure_pipe.py

The explainer returns ones, so the time is that of the pipe. A question is an episode of 100 timesteps, or a
step of the 100 teams of a block that play on the explanation.
"""

from __future__ import annotations

import time
from functools import partial
from statistics import median

import torch
from torch import Tensor

from xmarl_bench.explain.adapters import as_explainer
from xmarl_bench.explain.explainer import Explainer, run_explainer
from xmarl_bench.isolation.explainers import end_strangers
from xmarl_bench.plugins.names import find_policies
from xmarl_bench.plugins.registry import isolated
from xmarl_bench.policy import Policy, load_policy

POLICIES = {3: "navigation-n3-residual-lambda0.1-seed0", 5: "navigation-n5-residual-lambda0.1-seed0"}
TIMES, TIMESTEPS = 200, 100


def ones(observations: Tensor) -> Tensor:
    return observations.new_ones(*observations.shape[:2], observations.shape[1])


def seconds(explainer: Explainer, policy: Policy, observations: Tensor) -> float:
    """The median time of a call."""
    found = []
    for seed in range(TIMES):
        started = time.perf_counter()
        run_explainer(explainer, policy, observations, seed)
        found.append(time.perf_counter() - started)
    return median(found)


def main() -> None:
    torch.set_num_threads(1)
    here = as_explainer(ones)
    apart = isolated(here)
    for n_agents, name in POLICIES.items():
        policy, card = load_policy(find_policies()[name])
        observations = torch.randn(TIMESTEPS, n_agents, card.architecture.obs_dim)
        added = partial(seconds, policy=policy, observations=observations)
        cost = added(apart) - added(here)
        each = f"{cost / TIMESTEPS * 1e6:.0f} us a timestep"
        print(f"{n_agents} agents: {cost * 1e3:.1f} ms a question, {each}")
    end_strangers()


if __name__ == "__main__":
    main()
