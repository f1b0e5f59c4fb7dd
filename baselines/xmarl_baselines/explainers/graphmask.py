"""GraphMask after its paper: the fewest messages that leave the prediction nearly as it was.

Paper: Schlichtkrull, De Cao and Titov, "Interpreting Graph Neural Networks for NLP With Differentiable Edge
Masking" (ICLR 2021). Formula, for one timestep, with a gate z per edge and a multiplier lambda:

    max over lambda, min over w of   scaling * mean over edges of P(z > 0)
                                     + softplus(lambda) * relu(D(z) - allowance),

    D(z) = ||F(1) - F(z)||^2 / ||F(1) - F(0)||^2,

z hard concrete (Louizos et al., ICLR 2018): s = sigmoid((logit(u) + a) / beta), u uniform, a = w + location;
z = clip(s (zeta - gamma) + gamma, 0, 1), then 0 or 1 by the threshold 0.5 with the gradient of what was
thresholded; P(z > 0) = sigmoid(a - beta log(-gamma / zeta)). Adam on w, centred RMSprop on lambda, which goes
on from step to step and stays in [-2, 30]. As in the authors' code, the gates are read without noise and
temperature every few steps, and the mask of 0 and 1 kept is the one with the fewest messages among those with
D <= allowance, which the mask of ones always is. beta, gamma, zeta, location and first lambda are theirs too.

Departures from the paper:
- w is a logit per edge and timestep, not a network of the hidden states: the paper's own non-amortised
  variant. It can see what an amortised one cannot, which gate happens to do for this one timestep.
- A dropped message becomes 0, not a learned baseline, for that is what the metrics put in its place.
- The allowance is a fraction of the change that removing all messages makes. The paper's 0.03 is absolute and
  made for classifiers; actions change by so little that all masks come out empty under it.
- 60 steps for each timestep instead of epochs over a dataset, so both learning rates are larger: 0.1. They,
  the steps and the allowance were chosen on two throwaway policies (discovery and navigation, 4 agents,
  training seed 9001, never scored) run with 3 and 5 agents, among 50 settings, by FidDelta over the oracle's
  and communication-only budgeted fidelity: 0.94 and 0.63 there. 100 steps reach 0.93 and 0.66.

Departures from torch_geometric 2.8.1 (`graphmask-pyg`), beside these: messages are those of the policy,
observations are not scaled by a mask of features, lambda is kept, the threshold is 0.5, the constraint holds.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from xmarl_baselines.explainers.batching import by_chunks, timestep_seeds
from xmarl_baselines.explainers.frozen_policy import frozen
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.messages_only import messages_only
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import Policy

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
    read_every: int = 5  # steps between looks at the gates without noise


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

    `policy` is not touched, but its parameters should not require gradients: they would be computed.
    """

    def change(mask: Tensor) -> Tensor:
        """(S, N, N) -> (S,): ||F(1) - F(mask)||^2."""
        return (policy.decode(prepared, mask).action - target).square().sum(dim=(-2, -1))

    with torch.no_grad():
        prepared = policy.prepare(observations)
        target = policy.decode(prepared).action
        # Where removing everything changes nothing, D is 0 and every gate closes.
        largest = change(torch.zeros_like(noise[0])).clamp_min(torch.finfo(noise.dtype).tiny)
    w = torch.zeros_like(noise[0], requires_grad=True)
    multiplier = torch.full_like(largest, settings.init_lambda, requires_grad=True)
    gates = torch.optim.Adam([w], lr=settings.lr, fused=True)
    ascent = torch.optim.RMSprop([multiplier], lr=settings.lambda_lr, centered=True, maximize=True)
    kept = torch.ones_like(noise[0])
    for step, u in enumerate(noise, start=1):
        a = w + settings.location
        z = _hard(torch.sigmoid((torch.logit(u) + a) / BETA))
        is_open = torch.sigmoid(a - BETA * math.log(-GAMMA / ZETA)).mean(dim=(-2, -1))
        violation = torch.relu(change(z) / largest - settings.allowance)
        loss = settings.scaling * is_open + F.softplus(multiplier) * violation
        w.grad, multiplier.grad = torch.autograd.grad(loss.sum(), [w, multiplier])
        gates.step()
        ascent.step()
        with torch.no_grad():
            multiplier.clamp_(MIN_LAMBDA, MAX_LAMBDA)
            if step % settings.read_every == 0:
                mask = _hard(torch.sigmoid(w + settings.location))
                fewer = mask.sum(dim=(-2, -1)) < kept.sum(dim=(-2, -1))
                better = fewer & (change(mask) / largest <= settings.allowance)
                kept = torch.where(better[:, None, None], mask, kept)
    return kept


def _hard(s: Tensor) -> Tensor:
    """Gates in (0, 1) -> 0 or 1, with the gradient of the stretched gate clipped to [0, 1]."""
    soft = (s * (ZETA - GAMMA) + GAMMA).clamp(0, 1)
    return (soft > THRESHOLD).to(s.dtype) + (soft - soft.detach())


def graphmask_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N) of zeros and ones."""
    n_steps, n_agents, _ = observations.shape
    policy, seeds = frozen(policy), timestep_seeds(n_steps, generator)

    def explain(steps: slice) -> Tensor:
        noise = uniform_noise(SETTINGS.epochs, n_agents, seeds[steps])
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
)

graphmask_messages = messages_only(graphmask)
