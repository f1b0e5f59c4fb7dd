"""Many teams in one forward pass, each with the same bits as alone.

Rounding of a matrix product over a batch depends on the size of the batch. Here each team has its own product
(`torch.bmm`), and widths are padded with zeros to whole vectors: every team's memory then begins at a
vector's boundary, and no elementwise function has a remainder, which torch rounds differently.

B is the number of teams, N agents, D observation entries, H entries of memory, A action entries.
"""

from __future__ import annotations

import copy
from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from xmarl_bench.errors import InputError
from xmarl_bench.policy.architecture import raw_width
from xmarl_bench.policy.distribution import action_distribution
from xmarl_bench.policy.elsewhere import PolicyElsewhere
from xmarl_bench.policy.interface import Policy
from xmarl_bench.policy.network import GraphPolicy
from xmarl_bench.reproducible import one_thread

VECTOR = 32  # float32 numbers: two of a CPU's widest vectors, because torch unrolls its loops by two

# (B, N, D + H), mask (N, N) or None -> actions (B, N, A) or (B, N), next memory (B, N, H).
StepTeams = Callable[[Tensor, Tensor | None], tuple[Tensor, Tensor]]


def step_teams(policy: Policy) -> StepTeams:
    """The policy as it acts in rollouts: the bits of a team's action depend on its own observations only.

    A network with one attention layer on the complete graph and without memory runs for all teams at once,
    any other network for one team at a time. torch must have allocated the input tensors, because it aligns
    them.
    """
    if isinstance(policy, PolicyElsewhere):
        return policy.step_teams
    private = copy.deepcopy(policy).eval().requires_grad_(False)  # torch aligns the copy's memory
    if isinstance(private, GraphPolicy) and private.memory_dim == 0:
        return _AllAtOnce(private)

    def one_by_one(observation: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor]:
        # Strides matter too: an axis of size 1 may have any stride, and matrix products depend on it.
        teams = [team.clone(memory_format=torch.contiguous_format) for team in observation.split(1)]
        steps = [private.step(team, mask) for team in teams]
        choices, memories = zip(*((taken.choice, memory) for taken, memory in steps), strict=True)
        return torch.cat(choices), torch.cat(memories)

    return one_by_one


class _AllAtOnce:
    """`GraphPolicy.step` without memory, see `GraphPolicy.prepare` and `GraphPolicy.decode`."""

    def __init__(self, policy: GraphPolicy) -> None:
        layer = policy.gat
        self.architecture, self.activation = policy.architecture, policy.gat_activation
        self.encoder, self.decoder = _team_by_team(policy.encoder), _team_by_team(policy.decoder)
        self.message, self.receiver = _TeamLinear(layer.lin_l), _TeamLinear(layer.lin_r)
        self.residual = None if layer.res is None else _TeamLinear(layer.res)
        self.att, self.bias, self.slope = (
            _filled(layer.att.view(-1)),
            _filled(layer.bias),
            layer.negative_slope,
        )

    @one_thread()  # several threads would share out teams, and round by their number
    def __call__(self, observation: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor]:
        if observation.shape[-1] != self.architecture.obs_dim:  # padding would hide it
            raise InputError(
                f"the policy takes observations of {self.architecture.obs_dim} entries, got "
                f"{observation.shape[-1]}: choose a policy trained for this task."
            )
        x = self.encoder(_filled(observation))
        message, receiver = self.message(x), self.receiver(x)
        pair = F.leaky_relu(receiver[:, :, None] + message[:, None, :], self.slope)
        attention = torch.softmax((pair * self.att).sum(dim=-1), dim=-1)
        weight = attention if mask is None else attention * mask
        own = self.bias if self.residual is None else self.residual(x) + self.bias
        a = self.architecture
        raw = self.decoder(self.activation(torch.bmm(weight, message) + own))
        raw = raw[..., : raw_width(a.distribution, a.action_dim)]
        return action_distribution(raw, a.distribution).choice, observation[..., :0]


class _TeamLinear(nn.Module):
    """A linear layer on widths padded to whole vectors, with a product for each team."""

    def __init__(self, layer: nn.Module) -> None:
        super().__init__()
        weight, bias = layer.weight, layer.bias
        assert isinstance(weight, Tensor) and isinstance(bias, Tensor | None)
        self.weight = _filled(_filled(weight).t()).contiguous()
        self.bias = None if bias is None else _filled(bias)

    def forward(self, x: Tensor) -> Tensor:
        """(B, N, filled) -> (B, N, filled)."""
        out = torch.bmm(x, self.weight.expand(len(x), -1, -1))
        return out if self.bias is None else out + self.bias


def _team_by_team(layers: nn.Sequential) -> nn.Sequential:
    return nn.Sequential(*(_TeamLinear(each) if isinstance(each, nn.Linear) else each for each in layers))


def _filled(x: Tensor) -> Tensor:
    """(..., n) -> padded with zeros to whole vectors."""
    return F.pad(x.detach(), (0, -x.shape[-1] % VECTOR))
