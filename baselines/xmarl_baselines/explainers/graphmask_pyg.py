"""GraphMask of torch_geometric 2.8.1 with its bugs, to compare with results that others got from it.

Paper: Schlichtkrull, De Cao and Titov, "Interpreting Graph Neural Networks for NLP With Differentiable Edge
Masking" (ICLR 2021): hard-concrete gates on unmodified messages, a learned baseline in place of a dropped
message, and the fewest messages under a constraint on the change of the prediction, by a Lagrangian.
`graphmask` implements that, per timestep.

PyG's code does this instead on a policy of this benchmark (verified on 2.8.1; restated here, not corrected):

- the explained layer's messages become relu(layer_norm(message)), so it explains another network, and at the
  end the gates get messages that are already gated;
- an untrained feature mask scales the observations although no feature mask was requested;
- every epoch creates lambda again, so the constraint never tightens;
- if the layer's input and output sizes differ (navigation: 6 -> 32), the gates are created again after the
  optimiser got the old ones: nothing is trained;
- the hard threshold is the midpoint of the smallest and largest gate, so "all gates open" gives all zeros,
  and masks are 0 or 1;
- the learned baselines are scalars.

Departures: none from PyG. Its loop is restated with parameters, an objective and a random stream for each
timestep. On the same random numbers masks equal PyG's own, one graph at a time, in float64 (tested). In
float32 a gate near the threshold may fall to the other side. Policies other than a `GraphPolicy` run through
PyG's class itself, one graph at a time.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch_geometric.explain import GraphMaskExplainer
from torch_geometric.nn import MessagePassing

from xmarl_baselines.explainers.batching import by_chunks
from xmarl_baselines.explainers.frozen_policy import frozen
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.pyg import PygExplain
from xmarl_bench.metrics.absence import Absence
from xmarl_bench.policy import GraphPolicy, Policy
from xmarl_bench.reproducible import timestep_seeds

BETA, GAMMA, ZETA, LOCATION = 1 / 3, -0.2, 1.2, 2  # hard concrete; fixed in PyG
STEPS_AT_ONCE = 128  # a timestep has up to 17,000 parameters, of which Adam keeps three more copies


@dataclass(frozen=True)
class GraphMaskPygSettings:
    """PyG's names and defaults."""

    epochs: int = 100
    lr: float = 0.01
    penalty_scaling: int = 5
    lambda_optimizer_lr: float = 0.01  # no effect: every lambda lives for one step
    init_lambda: float = 0.55
    allowance: float = 0.03


class Gates(NamedTuple):
    """Parameters of PyG's gates, one set per timestep; V is the width of gate inputs, W of the layer.

    The three inputs are, in this order, embeddings of the sender, message, embeddings of the receiver.
    """

    transforms: list[Tensor]  # 3 x (S, W, V)
    scales: list[Tensor]  # 3 x (S, W), of the layer norms
    shifts: list[Tensor]  # 3 x (S, W)
    bias: Tensor  # (S,)
    weight: Tensor  # (S, W), of the output layer
    offset: Tensor  # (S,)
    baseline: Tensor  # (S,), always float32 as in PyG

    def parameters(self) -> list[Tensor]:
        """All trained tensors."""
        singles = [self.bias, self.weight, self.offset, self.baseline]
        return [*self.transforms, *self.scales, *self.shifts, *singles]

    def logits(self, layer: LayerState) -> Tensor:
        """(S, N, N): one logit per edge."""
        n_steps, n_agents, width = layer.sender.shape
        of_sender, of_message, of_receiver = (
            F.layer_norm(x.flatten(1, -2) @ transform.mT, (width,)) * scale[:, None] + shift[:, None]
            for x, transform, scale, shift in zip(
                layer, self.transforms, self.scales, self.shifts, strict=True
            )
        )
        of_message = of_message.view(n_steps, n_agents, n_agents, width)
        total = self.bias.view(-1, 1, 1, 1) + of_sender[:, None, :] + of_message + of_receiver[:, :, None]
        return torch.einsum("sijw,sw->sij", torch.relu(total / 3), self.weight) + self.offset.view(-1, 1, 1)


class LayerState(NamedTuple):
    """The inputs of the gates, which PyG's hook keeps from a pass through the layer."""

    sender: Tensor  # (S, N, W): W_l x_j
    message: Tensor  # (S, N, N, W) on j -> i
    receiver: Tensor  # (S, N, W): W_r x_i


class Start(NamedTuple):
    """The random draws for one timestep, in PyG's order."""

    feature_mask: Tensor  # (1, D) logits
    gates: Gates  # without the axis of timesteps
    noise: Tensor  # (epochs, N, N)


def draw(policy: GraphPolicy, n_agents: int, epochs: int, seed: int) -> Start:
    """The same draws as PyG after `torch.manual_seed(seed)`, in the same order and shapes."""
    generator = torch.Generator().manual_seed(seed)
    n_in, width = policy.gat.in_channels, policy.gat.out_channels
    n_features = policy.architecture.obs_dim + policy.memory_dim
    feature_mask, gates = _draw_masks(n_features, n_in, width, generator)
    if n_in != width:  # PyG's gates do not fit their inputs, so it creates new ones
        feature_mask, gates = _draw_masks(n_features, width, width, generator)
    noise = [
        torch.empty(n_agents**2, 1).uniform_(1e-6, 1.0 - 1e-6, generator=generator) for _ in range(epochs)
    ]
    return Start(feature_mask, gates, torch.stack(noise).view(epochs, n_agents, n_agents))


def _draw_masks(n_features: int, n_in: int, width: int, generator: torch.Generator) -> tuple[Tensor, Gates]:
    feature_mask = torch.randn(1, n_features, generator=generator) * 0.1
    input_dims = (n_in, width, n_in)
    transforms = [torch.empty(width, dim) for dim in input_dims]
    for transform in transforms:  # torch.nn.Linear's initialisation, then overwritten
        nn.init.kaiming_uniform_(transform, a=math.sqrt(5), generator=generator)
    bound = math.sqrt(3.0) * math.sqrt(2.0 / float(sum(input_dims) + width))
    for transform in transforms:
        transform.uniform_(-bound, bound, generator=generator)
    weight, offset = torch.empty(1, width), torch.empty(1)
    nn.init.kaiming_uniform_(weight, a=math.sqrt(5), generator=generator)
    offset.uniform_(-1 / math.sqrt(width), 1 / math.sqrt(width), generator=generator)
    stdv = 1.0 / math.sqrt(width)
    baseline = torch.tensor(width, dtype=torch.float).uniform_(-stdv, stdv, generator=generator)
    ones, zeros = torch.ones(width), torch.zeros(width)
    bias = torch.tensor(0.0, dtype=torch.float)
    return feature_mask, Gates(transforms, [ones] * 3, [zeros] * 3, bias, weight[0], offset[0], baseline)


def gate_masks(
    policy: GraphPolicy, observations: Tensor, starts: list[Start], settings: GraphMaskPygSettings
) -> Tensor:
    """One chunk: (S, N, D) observations and the draws for each timestep -> masks (S, N, N)."""
    with torch.no_grad():
        target = policy.distribution(observations).action
        feature_mask = torch.stack([start.feature_mask for start in starts]).sigmoid()
        seen = observations * feature_mask
        original, scaled = layer_state(policy, observations), layer_state(policy, seen)
        prepared = policy.prepare(seen)
    gates = _stack([start.gates for start in starts])
    noise = torch.stack([start.noise for start in starts], dim=1)
    trained = policy.gat.in_channels == policy.gat.out_channels
    if not trained:
        noise = noise[-1:]  # epochs change nothing; only the last one's messages count
    multiplier = F.softplus(torch.tensor(settings.init_lambda))
    optimizer = torch.optim.Adam(gates.parameters(), lr=settings.lr)
    gated = scaled.message
    for u in noise:
        with torch.set_grad_enabled(trained):
            if trained:
                for parameter in gates.parameters():
                    parameter.requires_grad_()
            opened = gates.logits(original) + LOCATION
            z = _hard(torch.sigmoid((torch.log(u) - torch.log(1 - u) + opened) / BETA))
            baseline = gates.baseline.view(-1, 1, 1, 1)
            gated = scaled.message * z[..., None] + (1 - z)[..., None] * baseline
            if not trained:
                continue
            action = policy.head(gated.sum(dim=2) + prepared.own, prepared.memory)[0].action
            error = (action - target).square().mean(dim=(-2, -1))
            penalty = torch.sigmoid(opened - BETA * math.log(-GAMMA / ZETA)).mean(dim=(-2, -1))
            loss = multiplier * torch.relu(error - settings.allowance) + settings.penalty_scaling * penalty
            gradients = torch.autograd.grad(loss.sum(), gates.parameters())
        for parameter, gradient in zip(gates.parameters(), gradients, strict=True):
            parameter.grad = gradient
        optimizer.step()
    with torch.no_grad():
        last = scaled._replace(message=gated.detach())
        return _hard(torch.sigmoid(gates.logits(last) + LOCATION))


def layer_state(policy: GraphPolicy, observations: Tensor) -> LayerState:
    """(S, N, D) -> the inputs of the gates, with relu(layer_norm(message)) as messages."""
    x, _ = policy.encode(observations)
    sender, receiver = policy.gat.lin_l(x), policy.gat.lin_r(x)
    message = policy.prepare(observations).attention[..., None] * sender[:, None]
    return LayerState(sender, F.layer_norm(message, (message.shape[-1],)).relu(), receiver)


def _hard(s: Tensor) -> Tensor:
    """(S, N, N) in (0, 1) -> 0 or 1 by the midpoint of each timestep's range, gradients straight through."""
    soft = (s * (ZETA - GAMMA) + GAMMA).clamp(0, 1)
    midpoint = (soft.amin(dim=(-2, -1), keepdim=True) + soft.amax(dim=(-2, -1), keepdim=True)) / 2
    hard = (soft > midpoint).to(soft.dtype)
    return soft + (hard - soft).detach()


def _stack(gates: list[Gates]) -> Gates:
    """Stack the parameters of single timesteps along a new first axis."""
    fields: list[Tensor | list[Tensor]] = []
    for values in zip(*gates, strict=True):
        if isinstance(values[0], list):
            fields.append([torch.stack(part) for part in zip(*values, strict=True)])
        else:
            fields.append(torch.stack(values))
    return Gates(*fields)  # type: ignore[arg-type]


def graphmask_pyg_mask(policy: Policy, observations: Tensor, generator: torch.Generator) -> Tensor:
    """(S, N, D) -> (S, N, N) of zeros and ones."""
    if isinstance(policy, GraphPolicy):
        return batched(policy, observations, generator, SETTINGS)
    layers = [type(module).__name__ for module in policy.modules() if isinstance(module, MessagePassing)]
    try:
        return PygExplain(lambda: pyg_algorithm(len(layers), SETTINGS))(policy, observations, generator)
    except TypeError as error:
        raise InputError(
            f"PyG's GraphMask needs layers that pass x to their messages, got {', '.join(layers)} ({error}): "
            f"choose another explainer."
        ) from error


def batched(
    policy: GraphPolicy, observations: Tensor, generator: torch.Generator, settings: GraphMaskPygSettings
) -> Tensor:
    """(S, N, D) -> (S, N, N) of zeros and ones, chunk by chunk."""
    n_steps, n_agents, _ = observations.shape
    private, seeds = frozen(policy), timestep_seeds(n_steps, generator)

    def explain(steps: slice) -> Tensor:
        starts = [draw(private, n_agents, settings.epochs, seed) for seed in seeds[steps]]
        return gate_masks(private, observations[steps], starts, settings)

    masks = by_chunks(observations, explain, steps_at_once=STEPS_AT_ONCE)
    return masks.round()  # the straight-through sum may differ from 1 by rounding


def pyg_algorithm(n_layers: int, settings: GraphMaskPygSettings) -> GraphMaskExplainer:
    """PyG's GraphMaskExplainer with these settings."""
    return GraphMaskExplainer(num_layers=n_layers, log=False, **asdict(settings))


SETTINGS = GraphMaskPygSettings()

graphmask_pyg = Explainer(
    "graphmask-pyg",
    graphmask_pyg_mask,
    "PyG's GraphMask as it is, known bugs included, batched over timesteps",
    stochastic=True,
    slow=True,
    hyperparameters=asdict(SETTINGS),
    absence=Absence.ZERO,
)
