"""Policies in the process of a stranger's code: opens them, keeps them, and answers for them.

S is the number of timesteps, N agents, D observation entries.
"""

from __future__ import annotations

import copy
import pickle
from collections.abc import Sequence
from importlib.metadata import EntryPoint
from typing import Any

import torch
from torch import Tensor

from xmarl_bench.explain.sanity import shuffled_weights
from xmarl_bench.isolation.conversation import sendable
from xmarl_bench.isolation.tensors import Sent
from xmarl_bench.origin.code_hash import object_sha256
from xmarl_bench.plugins.code_policies import open_module, run_policy
from xmarl_bench.policy import Policy
from xmarl_bench.policy.interventions import random_teams
from xmarl_bench.policy.policy_module import PolicyModule
from xmarl_bench.policy.teams_apart import StepTeams, step_teams
from xmarl_bench.reproducible import one_thread, torch_defaults
from xmarl_bench.tasks.sources import known_task

Answer = tuple[dict[str, Any], bytes]


@torch_defaults()
def open_code(question: dict[str, Any]) -> Answer:
    """Run the code of a policy: what the harness has to know, and the policy, pickled for such processes.

    A task that it brings follows, pickled.
    """
    if "pickled" in question:
        made = pickle.loads(question["pickled"])
        policy, card = open_module(made, question["origin"]) if isinstance(made, PolicyModule) else made
    else:
        plugin = question["plugin"]
        policy, card = run_policy(question["policy"], None if plugin is None else EntryPoint(*plugin))
    pickled = sendable(f"policy {card.name!r}", policy)
    teams = random_teams(1, card.n_agents, card.architecture.obs_dim)
    states = torch.cat([teams, policy.initial_state(card.n_agents)[None]], dim=-1)
    task = known_task(card.task)
    factory = b"" if task.origin is None else sendable(f"task {card.task!r}", task.factory)
    header = {
        "task_bytes": len(factory),
        "card": card.model_dump_json(),
        "key": object_sha256(policy),
        "row_wise": policy.row_wise,
        "memory_dim": policy.memory_dim,
        "no_attention": policy.why_no_attention(states),
    }
    return header, pickled + factory


class Policies:
    """The policies that the harness has sent."""

    def __init__(self) -> None:
        self._kept: dict[str, Policy | tuple[bytes, int | None]] = {}
        self._teams: tuple[str, StepTeams] | None = None  # the one that acts

    def receive(self, question: dict[str, Any]) -> None:
        for forgotten in question.get("policies", ()):
            del self._kept[forgotten]
        if "weights" in question:
            self._kept[question["policy"]] = question["weights"], question["shuffled"]

    def get(self, key: str) -> Policy:
        """The policy, unpickled when it is first asked for, so that a failure is that question's."""
        kept = self._kept[key]
        if isinstance(kept, tuple):
            policy: Policy = copy.deepcopy(pickle.loads(kept[0])).eval()  # torch aligns the copy's memory
            kept = self._kept[key] = policy if kept[1] is None else shuffled_weights(policy, kept[1])
        return kept

    def answer(self, question: dict[str, Any]) -> Answer:
        """Tensors, with their strides and alignment in the header."""
        self.receive(question)
        key = question["policy"]
        policy, given = self.get(key), [None if each is None else each.tensor() for each in question["given"]]
        with one_thread(), torch.no_grad():
            if question["what"] == "initial_state":
                found: Sequence[Tensor] = [policy.initial_state(question["n_agents"]).float()]
            elif question["what"] == "attention":
                found = [policy.attention(_there(given[0]))]
            elif question["what"] == "choose":
                found = [each.float() for each in self._acting(key, policy)(_there(given[0]), given[1])]
            elif question["what"] == "gradient":
                found = [_gradient(policy, _there(given[0]), _there(given[1]), given[2:])]
            elif question["what"] == "step":
                distribution, memory = policy.step(_there(given[0]), given[1])
                found = [distribution.loc, distribution.scale, memory]
            else:
                distribution = policy.distribution(_there(given[0]), given[1])
                found = [distribution.loc, distribution.scale]
        sent = [Sent.of(each) for each in found]
        return {"layouts": [each.layout for each in sent]}, b"".join(each.data for each in sent)

    def _acting(self, key: str, policy: Policy) -> StepTeams:
        if self._teams is None or self._teams[0] != key:
            self._teams = key, step_teams(policy)
        return self._teams[1]


def _gradient(policy: Policy, x: Tensor, mask: Tensor, gradients: Sequence[Tensor | None]) -> Tensor:
    """Of F(mask), from the gradients of its location and its scale."""
    with torch.enable_grad():
        mask.requires_grad_()
        distribution = policy.distribution(x, mask)
        outputs = [
            (each, gradient)
            for each, gradient in zip((distribution.loc, distribution.scale), gradients, strict=True)
            if gradient is not None
        ]
        (found,) = torch.autograd.grad([each for each, _ in outputs], mask, [each for _, each in outputs])
    return found


def _there(tensor: Tensor | None) -> Tensor:
    assert tensor is not None
    return tensor
