"""Explainers that misbehave like faulty third-party plugins."""

from __future__ import annotations

import torch
from torch import Tensor

from xmarl_bench.explain.explainer import Explain, Explainer
from xmarl_bench.policy import GraphPolicy, Policy


def _constant(value: float) -> Explain:
    def explain(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        n_steps, n_agents, _ = observations.shape
        return torch.full((n_steps, n_agents, n_agents), value)

    return explain


def _late_nan(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    mask = torch.ones(len(observations), observations.shape[1], observations.shape[1])
    mask[1:] = torch.nan  # the first timestep is valid
    return mask


def _wrong_shape(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    return torch.ones(len(observations), observations.shape[1], 1)


def _not_a_tensor(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    return [[1.0]]  # type: ignore[return-value]


def _integers(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    return torch.ones(len(observations), observations.shape[1], observations.shape[1], dtype=torch.long)


def _crash(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    raise RuntimeError("out of coffee")


def _vandal(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """Returns a valid mask, but changes all its arguments and every global state it can reach."""
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.zero_()
            parameter.requires_grad_(False)
    policy.train()
    assert isinstance(policy, GraphPolicy)
    policy.gat.register_message_forward_hook(lambda *_: torch.zeros(1))
    observations.fill_(7.0)
    torch.manual_seed(12345)
    n_steps, n_agents, _ = observations.shape
    return torch.rand(n_steps, n_agents, n_agents)


BAD = {
    explainer.name: explainer
    for explainer in (
        Explainer("nan", _constant(torch.nan)),
        Explainer("late-nan", _late_nan),
        Explainer("infinite", _constant(torch.inf)),
        Explainer("too-large", _constant(1.5)),
        Explainer("negative", _constant(-0.1)),
        Explainer("wrong-shape", _wrong_shape),
        Explainer("not-a-tensor", _not_a_tensor),
        Explainer("integers", _integers),
        Explainer("crash", _crash),
    )
}
nan = BAD["nan"]
late_nan = BAD["late-nan"]
wrong_shape = BAD["wrong-shape"]
crash = BAD["crash"]
slow = Explainer("slow", _constant(0.5), slow=True)
vandal = Explainer("vandal", _vandal, stochastic=True)
misnamed = Explainer("another", _constant(0.5))
not_an_explainer = "a string"
