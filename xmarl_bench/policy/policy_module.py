"""Policies with their own code: any torch module that passes messages along `edge_index`.

Scoring one runs its author's code, so the command line requires `--trust-code`, and entries record it. Prefer
a bundle, which holds no code, where the architecture allows it: see xmarl_bench.policy.bundle.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError
from safetensors.torch import save
from torch import nn

from xmarl_bench.errors import InputError
from xmarl_bench.origin.references import Origin
from xmarl_bench.policy.architecture import CodeArchitecture, DistributionKind
from xmarl_bench.policy.bundle import PolicyCard
from xmarl_bench.policy.graph import CompleteGraph, Graph
from xmarl_bench.policy.interventions import check_interventions, random_teams
from xmarl_bench.policy.module import ModulePolicy
from xmarl_bench.policy.tensors import check_tensors
from xmarl_bench.records.strict_json import first_error
from xmarl_bench.reproducible import torch_defaults
from xmarl_bench.tasks.sources import open_task


@dataclass(frozen=True)
class PolicyModule:
    """A trained network, and what it was trained for: the return value of a `module:factory`.

    network: forward(x (n, D), edge_index (2, edges)) -> (n, 2A), for each agent the location of its action's
        Normal and the scale before the biased softplus; (n, A) if `distribution` is "deterministic"; a logit
        for each of the task's actions if it is "categorical". The rows are agents of one
        team or of many at once; they may interact in torch_geometric's message-passing layers only, which
        pass one message for each edge. A network with memory has `initial_state` and `step` instead of
        forward, see xmarl_bench.policy.recurrent.
    task: its name, or the task itself: a subclass of xmarl_envs.Task, or a function of a team size that
        returns a PettingZoo ParallelEnv.
    distribution: "tanh_normal", "normal", "deterministic" or "categorical", see ActionDistribution.
    graph: which agents hear which.
    attention_entropy: weight of the attention-entropy term in training, 0 without it.
    """

    name: str
    network: nn.Module
    task: str | Callable[..., Any]
    n_agents: int
    distribution: DistributionKind = "tanh_normal"
    graph: Graph = field(default_factory=CompleteGraph)
    attention_entropy: float = 0.0
    training_seed: int | None = None

    @torch_defaults()
    def open(self, origin: Origin) -> tuple[ModulePolicy, PolicyCard]:
        """The policy with its card, as `load_policy` returns them for a bundle.

        Raises InputError for an unknown task, a network that masks cannot explain (see ModulePolicy and
        xmarl_bench.policy.interventions), and an invalid name, team size or distribution.
        """
        if not isinstance(self.network, nn.Module):
            raise InputError(
                f"the network of policy {self.name!r} is a {type(self.network).__name__}: "
                f"give a torch module."
            )
        if not (isinstance(self.task, str) or callable(self.task)) or not isinstance(self.n_agents, int):
            raise InputError(
                f"policy {self.name!r} has task {self.task!r} and n_agents {self.n_agents!r}: "
                f"give a name and a whole number."
            )
        check_tensors(self.network, self.name)
        # Whoever runs the policy's code runs that of its task.
        source = open_task(self.task, trust_code=True)
        task = source.make(self.n_agents).with_actions(self.distribution != "categorical")
        obs_dim, action_dim = task.obs_dim, task.action_width
        try:
            card = PolicyCard(
                name=self.name,
                task=source.name,
                n_agents=self.n_agents,
                attention_entropy=self.attention_entropy,
                training_seed=self.training_seed,
                architecture=CodeArchitecture(
                    obs_dim=obs_dim,
                    action_dim=action_dim,
                    entry_point=origin.entry_point,
                    package=origin.distribution,
                    version=origin.version,
                    code_sha256=origin.code_sha256,
                    distribution=self.distribution,
                    graph=self.graph,
                ),
                weights_sha256=_weights_sha256(self.network),
            )
        except ValidationError as error:
            problem, where = first_error(error)
            raise InputError(f"policy {self.name!r} has no valid {where}: {problem}.") from None
        policy = ModulePolicy(
            self.network,
            obs_dim,
            action_dim,
            distribution=self.distribution,
            graph=self.graph,
            n_agents=self.n_agents,
        )
        check_interventions(policy, random_teams(2, self.n_agents, obs_dim))
        return policy, card


def _weights_sha256(network: nn.Module) -> str:
    """SHA-256 of the weights as safetensors; tensors that share memory are written twice."""
    state = {name: tensor.detach().clone().contiguous() for name, tensor in network.state_dict().items()}
    return hashlib.sha256(save(state)).hexdigest()
