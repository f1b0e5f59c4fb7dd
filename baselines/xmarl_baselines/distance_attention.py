"""An initialisation under which agents attend to themselves and, the nearer they are, to one another.

A GATv2 layer scores edge j -> i by a . LeakyReLU(W x_j + V x_i). With rows of W in pairs (w, -w), V = -W and
a = -c, a pair contributes -c (LeakyReLU(z) + LeakyReLU(-z)) = -0.8 c |w . (x_j - x_i)|: zero for the agent
itself, falling with the distance to the other. From torch's own initialisation attention starts uniform,
and an agent whose encoder is the identity sees only the team's mean: it does not even know its own goal.
All parameters stay trainable; the architecture is the paper's.
"""

from __future__ import annotations

import math

import torch
from torch import nn

from xmarl_bench.policy import GraphPolicy

DIAGONAL = math.sqrt(0.5)
# Of position space, each followed by its opposite.
DIRECTIONS = tuple(
    (sign * x, sign * y)
    for x, y in ((1.0, 0.0), (0.0, 1.0), (DIAGONAL, DIAGONAL), (DIAGONAL, -DIAGONAL))
    for sign in (1.0, -1.0)
)
OFFSET = 4.0  # m; positions plus this are positive, which relu leaves as they are


@torch.no_grad()
def attend_by_distance(policy: GraphPolicy, sharpness: float) -> None:
    """Set 8 of the layer's rows so that a neighbour at r metres scores about 1.9 * sharpness * r below self.

    Takes a policy whose observations begin with the position (x, y). An encoder of relu layers is given two
    channels that pass the position on.
    """
    _pass_position_on(policy)
    gat = policy.gat
    n = len(DIRECTIONS)
    rows = torch.zeros(n, gat.in_channels)
    rows[:, :2] = torch.tensor(DIRECTIONS)
    gat.lin_l.weight[:n], gat.lin_r.weight[:n] = rows, -rows
    gat.lin_l.bias[:n] = gat.lin_r.bias[:n] = 0.0
    gat.att[..., :n] = -sharpness


def _pass_position_on(policy: GraphPolicy) -> None:
    """Channels 0 and 1 of a relu encoder become x + OFFSET and y + OFFSET."""
    layers = [layer for layer in policy.encoder if isinstance(layer, nn.Linear)]
    for depth, layer in enumerate(layers):
        layer.weight[:2] = torch.eye(2, layer.in_features)
        layer.bias[:2] = OFFSET if depth == 0 else 0.0
