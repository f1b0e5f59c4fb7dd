"""Social influence: how differently would the receiver act if the sender had said something else?

Paper: Jaques et al., "Social Influence as Intrinsic Motivation for Multi-Agent Deep Reinforcement Learning"
(ICML 2019), the counterfactual reward of section 3. Formula: the influence of the message j -> i is

    c_ij = KL( p_i(. | m_j) || 1/K sum_k p_i(. | m_j^k) ),

with the distribution p_i of the receiver's action, the message m_j of j, and its message m_j^k in a reference
state: a state of an episode that no score plays, drawn at random for each timestep and k. All other messages
and the receiver's coefficients are unchanged: this is the absence model `resample`. A message without
attention has no influence.

For discrete actions the right side is a categorical, and the KL is exact. For continuous ones it is a mixture
of Normals, and a KL to that has no closed form. The smallest of its variational upper bounds replaces it
(Hershey and Olsen, "Approximating the Kullback Leibler Divergence Between Gaussian Mixture Models", ICASSP
2007),

    c_ij = -log 1/K sum_k exp(-KL(p_i || p_i^k)),

each KL in closed form, between the diagonal Normals under the tanh, which equals that of the TanhNormals. No
actions are drawn. The bound is 0 if no other message changes the distribution, exact if all components
are equal, and at most the mean of their KLs.

Departures: messages instead of actions, with a marginal over reference states, not over the sender's own
policy. The mask is c / max c over the row; own edges are kept, because they are not messages between agents.
Coefficients and messages must be known: policies of several layers or heads are refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from xmarl_baselines.explainers.batching import AGENTS_AT_ONCE, by_chunks
from xmarl_bench.errors import InputError
from xmarl_bench.explain.adapters import as_explainer
from xmarl_bench.explain.effect import action_divergence, share_of_largest
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import ActionDistribution, GraphPolicy, Policy


@dataclass(eq=False)
class Influence:
    """The explainer. Fitting stores the reference states."""

    draws: int = 32  # K other messages of each sender, for each timestep
    reference: Tensor = field(init=False, repr=False)  # (Q, N, D)

    def fit(self, observations: Tensor) -> None:
        """(Q, N, D) reference states."""
        self.reference = observations

    def explain(self, policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
        """(S, N, D) -> (S, N, N). Raises InputError if coefficients are not known."""
        if not isinstance(policy, GraphPolicy):
            raise InputError(
                "influence replaces messages by others, which needs known coefficients: a policy with one "
                "layer of one head. Choose another explainer or policy."
            )
        known: GraphPolicy = policy
        n_steps, n_agents, _ = observations.shape
        drawn = torch.randint(len(self.reference), (self.draws, n_steps), generator=generator)

        def explain(steps: slice) -> Tensor:
            influence = influences(known, observations[steps], messages[drawn[:, steps]])
            return share_of_largest(influence) + torch.eye(n_agents)

        with torch.no_grad():
            messages = known.prepare(self.reference).message
            width = max(1, AGENTS_AT_ONCE // (self.draws * n_agents))
            return by_chunks(observations, explain, steps_at_once=width)


def influences(policy: GraphPolicy, observations: Tensor, said: Tensor) -> Tensor:
    """One chunk: (S, N, D), and (K, S, N, W) other messages of each sender -> (S, N, N), diagonal 0."""
    n_steps, n_agents, _ = observations.shape
    prepared = policy.prepare(observations)
    actual = policy.decode(prepared)
    influence = observations.new_zeros(n_steps, n_agents, n_agents)
    for j in range(n_agents):
        others = torch.ones(n_agents, n_agents)
        others[:, j] = 0.0
        mask = others.expand(*said.shape[:2], -1, -1)
        influence[:, :, j] = kl_to_mixture(actual, policy.decode(prepared, mask, said))
    return influence * (1.0 - torch.eye(n_agents))


def kl_to_mixture(actual: ActionDistribution, others: ActionDistribution) -> Tensor:
    """KL in nats, exact or the bound above: (..., N, A), and (K, ..., N, A) of the mixture -> (..., N).

    Raises InputError if the policy is deterministic and so has no distribution.
    """
    if actual.kind == "deterministic":
        raise InputError(
            "influence compares distributions of actions, and the policy is deterministic: choose another "
            "explainer or policy."
        )
    if actual.kind == "categorical":
        mixture = others._replace(loc=others.loc.logsumexp(dim=0) - math.log(len(others.loc)))
        return torch.from_numpy(action_divergence(actual, mixture))
    kl = action_divergence(actual, others)
    bound = math.log(len(kl)) - torch.from_numpy(-kl).logsumexp(dim=0)
    return bound.clamp_min(0.0)  # rounding


influence = as_explainer(
    Influence(),
    name="influence",
    summary="counterfactual influence of each message on the receiver's distribution of actions",
    stochastic=True,
    needs_fit=True,
    absence=Absence.RESAMPLE,
    hyperparameters={"draws": Influence.draws, "own_edge": "kept", "normaliser": "c / max c over the row"},
)
