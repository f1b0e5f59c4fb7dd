"""GraphMask as in its paper: the fewest messages that nearly keep the prediction.

Paper: Schlichtkrull, De Cao and Titov, "Interpreting Graph Neural Networks for NLP With Differentiable Edge
Masking" (ICLR 2021). Formula, for one timestep, with a gate z per edge and a multiplier lambda:

    max over lambda, min over w of   scaling * mean over edges of P(z > 0)
                                     + softplus(lambda) * relu(D(z) - allowance),

    D(z) = ||F(1) - F(z)||^2 / ||F(1) - F(0)||^2,

with z hard concrete (Louizos et al., ICLR 2018): s = sigmoid((logit(u) + a) / beta), u uniform, a = w +
location; z = clip(s (zeta - gamma) + gamma, 0, 1), then 0 or 1 by the threshold 0.5 with a straight-through
gradient; P(z > 0) = sigmoid(a - beta log(-gamma / zeta)). Adam optimises w, centred RMSprop lambda, which is
kept from step to step and stays in [-2, 30]. As in the authors' code, the gates are read every few steps
without noise and temperature. The result is the binary mask with the fewest messages among those with D <=
allowance; the mask of ones is always one of them. beta, gamma, zeta, location and the first lambda are the
authors' too.

Departures from the paper:
- w is a logit per edge and timestep, not a network of the hidden states: the paper's own non-amortised
  variant, which can also pick a gate that happens to work for one timestep only.
- A dropped message becomes 0, as in the metrics, not a learned baseline.
- The allowance is a fraction of the change caused by removing all messages. The paper's 0.03 is absolute and
  made for classifiers: actions change so little that all masks would be empty.
- 60 steps for each timestep instead of epochs over a dataset, so both learning rates are larger: 0.1. These
  rates, the steps and the allowance are the best of 50 settings on two policies that are never scored
  (discovery and navigation, 4 agents, training seed 9001), run with 3 and 5 agents, by FidDelta relative to
  the oracle's and communication-only budgeted fidelity: 0.94 and 0.63 there. 100 steps reach 0.93 and 0.66.

Further departures from torch_geometric 2.8.1 (`graphmask-pyg`): messages are the policy's own, no feature
mask scales the observations, lambda is kept, the threshold is 0.5, and the constraint holds.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from xmarl_baselines.explainers.batching import by_chunks
from xmarl_baselines.explainers.closed_form import actions_of
from xmarl_baselines.explainers.frozen_policy import frozen
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.messages_only import messages_only
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import Policy
from xmarl_bench.reproducible import timestep_seeds

BETA, GAMMA, ZETA = 1 / 3, -0.2, 1.0  # temperature and stretch of the hard concrete
THRESHOLD = 0.5  # of the stretched gate
MIN_LAMBDA, MAX_LAMBDA = -2.0, 30.0


@dataclass(frozen=True)
class GraphMaskSettings:
    """How the gates are optimised."""

    epochs: int = 60
    lr: float = 0.1  # of the gates
    location: float = 3.0  # first logit of every gate
    scaling: float = 1.0  # weight of the share of open gates
    allowance: float = 0.01  # tolerated D(z)
    init_lambda: float = 0.55
    lambda_lr: float = 0.1
    read_every: int = 5  # steps between readings of the gates without noise


def uniform_noise(epochs: int, n_agents: int, seeds: list[int]) -> Tensor:
    """(epochs, S, N, N) in (0, 1), a stream per timestep."""
    shape = (epochs, n_agents, n_agents)
    draws = [
        torch.empty(shape).uniform_(1e-6, 1 - 1e-6, generator=torch.Generator().manual_seed(seed))
        for seed in seeds
    ]
    return torch.stack(draws, dim=1)


def optimise_gates(
    policy: Policy, observations: Tensor, noise: Tensor, settings: GraphMaskSettings
) -> Tensor:
    """One chunk: (S, N, D) observations, (epochs, S, N, N) uniform noise -> masks (S, N, N) of 0 and 1.

    Leaves `policy` unchanged. Its parameters should not require gradients, which would be computed in vain.
    """

    def change(mask: Tensor) -> tuple[Tensor, Tensor]:
        """(S, N, N) -> F(mask) - F(1), and its squares' sum (S,)."""
        difference = actions.of(mask) - target
        return difference, difference.square().sum(dim=(-2, -1))

    with torch.no_grad():
        prepared = policy.prepare(observations)
        target = policy.decode(prepared).action
    actions = actions_of(policy, prepared)
    # If removing everything changes nothing, D is 0 and every gate closes.
    largest = change(torch.zeros_like(noise[0]))[1].clamp_min(torch.finfo(noise.dtype).tiny)
    w, kept = torch.zeros_like(noise[0]), torch.ones_like(noise[0])
    multiplier = torch.full_like(largest, settings.init_lambda)
    gates = torch.optim.Adam([w], lr=settings.lr, fused=True)
    ascent = torch.optim.RMSprop([multiplier], lr=settings.lambda_lr, centered=True, maximize=True)
    for step, drawn in enumerate(torch.logit(noise), start=1):
        a = w + settings.location
        s = torch.sigmoid((drawn + a) / BETA)
        is_open = torch.sigmoid(a - BETA * math.log(-GAMMA / ZETA))
        difference, changed = change(_hard(s))
        violation = torch.relu(changed / largest - settings.allowance)
        weight = F.softplus(multiplier) * (violation > 0) / largest
        by_gate = actions.gradient(weight[:, None, None] * (2 * difference)) * _slope_of_soft(s)
        by_share = settings.scaling / w[0].numel() * (1 - is_open) * is_open
        w.grad = by_gate * (1 - s) * s / BETA + by_share
        multiplier.grad = violation * multiplier.sigmoid()
        gates.step()
        ascent.step()
        multiplier.clamp_(MIN_LAMBDA, MAX_LAMBDA)
        if step % settings.read_every == 0:
            mask = _hard(torch.sigmoid(w + settings.location))
            fewer = mask.sum(dim=(-2, -1)) < kept.sum(dim=(-2, -1))
            better = fewer & (change(mask)[1] / largest <= settings.allowance)
            kept = torch.where(better[:, None, None], mask, kept)
    return kept


def _hard(s: Tensor) -> Tensor:
    """Gates in (0, 1) -> 0 or 1."""
    return (s * (ZETA - GAMMA) + GAMMA > THRESHOLD).to(s.dtype)


def _slope_of_soft(s: Tensor) -> Tensor:
    """The derivative of clip(s (zeta - gamma) + gamma, 0, 1), which stands in for that of `_hard`."""
    soft = s * (ZETA - GAMMA) + GAMMA
    return ((soft >= 0) & (soft <= 1)) * (ZETA - GAMMA)


def graphmask_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N) of zeros and ones."""
    n_steps, n_agents, _ = observations.shape
    policy, seeds = frozen(policy), timestep_seeds(n_steps, generator)

    def explain(steps: slice) -> Tensor:
        noise = uniform_noise(SETTINGS.epochs, n_agents, seeds[steps]).to(observations.device)
        return optimise_gates(policy, observations[steps], noise, SETTINGS)

    return by_chunks(observations, explain)


SETTINGS = GraphMaskSettings()

graphmask = Explainer(
    "graphmask",
    graphmask_mask,
    "GraphMask after its paper: the fewest messages that nearly keep the action",
    stochastic=True,
    hyperparameters=asdict(SETTINGS),
    absence=Absence.ZERO,
    any_device=True,
)

graphmask_messages = messages_only(graphmask)
