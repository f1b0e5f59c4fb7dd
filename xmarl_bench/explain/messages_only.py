"""Makes an explainer explain messages between agents only: every agent's own edge is always kept.

Most explainers compare with a team whose agents do not even hear themselves. The leaderboard's order keeps
own edges, so these explainers explain another absence than the one they are measured by, which changes their
scores much. `messages_only(shapley)` is Shapley's value of each message for an agent that hears itself.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import as_explainer, origin_of_explainer
from xmarl_bench.explain.control_names import MESSAGES_ONLY
from xmarl_bench.explain.effect import NORMALISER, signed_to_unit
from xmarl_bench.explain.explainer import Explain, Explainer, Fit, explain_of
from xmarl_bench.explain.node_importance import as_edge_masks
from xmarl_bench.explain.pyg import PygExplain
from xmarl_bench.explain.returned_mask import as_floats, finite
from xmarl_bench.policy import ActionDistribution, Policy


class OwnKept(Policy):
    """A policy whose agents always hear themselves: masks do not apply to own edges."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy = policy
        self.graph, self.continuous_actions = policy.graph, policy.continuous_actions
        self.memory_dim, self.row_wise = policy.memory_dim, policy.row_wise

    def act(self, x: Tensor, edge_index: Tensor, weight: Tensor | None = None) -> Tensor:
        """(n, D), (2, edges) -> (n, A): F of the mask with own edges at 1."""
        if weight is not None:
            sender, receiver = edge_index
            weight = torch.where(sender == receiver, 1.0, weight)
        return self.policy.act(x, edge_index, weight)

    def prepare(self, observation: Tensor) -> Any:
        """(S, N, D) -> input of `decode`."""
        return self.policy.prepare(observation)

    def decode(self, prepared: Any, mask: Tensor | None = None) -> ActionDistribution:
        """F of the mask with its diagonal set to 1."""
        if mask is None:
            return self.policy.decode(prepared)
        return self.policy.decode(prepared, _with_own(mask))

    def attention(self, observation: Tensor) -> Tensor:
        """(S, N, D) -> (S, N, N)."""
        return self.policy.attention(observation)


def _with_own(mask: Tensor) -> Tensor:
    """(..., N, N) -> the same with ones on the diagonal, which have no gradient."""
    own = torch.eye(mask.shape[-1], dtype=mask.dtype, device=mask.device)
    return mask * (1.0 - own) + own


def messages_only(thing: object) -> Explainer:
    """The explainer, or anything that `as_explainer` accepts, as `NAME-messages`; its masks have own edges 1.

    For batched explainers that call `decode` with masks, as all shipped ones except attention's do. Raises
    InputError for algorithms of PyG and explainers that are not batched, which use the network itself, for
    one that simulates, and where `as_explainer` does.
    """
    explainer = as_explainer(thing)
    if isinstance(explainer.explain, PygExplain):
        raise InputError(
            f"explainer {explainer.name!r} is an algorithm of torch_geometric, which masks the network's own "
            f"layers: it cannot be kept from explaining own edges."
        )
    if not explainer.batched:
        raise InputError(
            f"explainer {explainer.name!r} is called for one timestep at a time, with the network: make it "
            f"batched to explain messages only."
        )
    if explainer.simulates:  # messages are those that the team sends
        raise InputError(
            f"explainer {explainer.name!r} plays on in the world of an episode: it cannot be asked about "
            f"messages alone."
        )
    mapped = {"normaliser": NORMALISER} if explainer.signed else {}
    return replace(
        explainer,
        name=f"{explainer.name}{MESSAGES_ONLY}",
        explain=_asked(explainer, explain_of(explainer)),
        summary=f"{explainer.summary}; an agent always hears itself",
        hyperparameters={**explainer.hyperparameters, **mapped, "own_edge": "kept"},
        signed=False,
        fit=None if explainer.fit is None else _asked_when_fitted(explainer, explainer.fit),
        node_importance=None,
        origin=origin_of_explainer(explainer),
    )


def _asked(explainer: Explainer, explain: Explain) -> Explain:
    def about_messages(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        n_steps, n_agents, _ = observations.shape
        returned = explain(OwnKept(policy), observations, generator)
        shape = n_steps, n_agents, n_agents
        masks = as_edge_masks(explainer.name, returned, shape, explainer.node_importance)
        floats = as_floats(explainer.name, masks, shape)
        if explainer.signed:  # own edges take no part in the scale of a row
            own = torch.eye(n_agents, dtype=floats.dtype, device=floats.device)
            floats = signed_to_unit(finite(explainer.name, floats) * (1.0 - own))
        return _with_own(floats)

    return about_messages


def _asked_when_fitted(explainer: Explainer, fit: Fit) -> Fit:
    def about_messages(policy: Policy, observations: Tensor, generator: torch.Generator) -> Explain:
        return _asked(explainer, fit(OwnKept(policy), observations, generator))

    return about_messages
