"""The explainers that pyproject.toml registers, even if the installation that runs the tests is older."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

from torch import Tensor

from tests.helpers.policies import random_observations
from xmarl_bench.explain.explainer import Explainer, fit_explainer
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.plugins.names import EXPLAINERS
from xmarl_bench.policy import Policy

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def shipped_plugins() -> list[EntryPoint]:
    """By name."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    named: dict[str, str] = project["entry-points"][EXPLAINERS]
    return [EntryPoint(name, where, EXPLAINERS) for name, where in sorted(named.items())]


def shipped_explainers() -> list[Explainer]:
    return [plugin.load() for plugin in shipped_plugins()]


def ready(explainer: Explainer, policy: Policy, observations: Tensor) -> Explainer:
    """The explainer as scoring would run it on such observations (S, N, 6) of navigation.

    Fitted if it learns, and with a simulator.
    """
    _, n_agents, obs_dim = observations.shape
    fitted = fit_explainer(explainer, policy, random_observations(40, n_agents, obs_dim, 9), 0)
    return replace(fitted, simulator=Simulator("blind_navigation_v0", n_agents, 0))
