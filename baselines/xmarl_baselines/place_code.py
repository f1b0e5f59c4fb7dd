"""An initialisation under which an agent tells its own place from its partners' in one mixture of messages.

The layer hands agent i only h_i = sum_j alpha_ij W x_j, the same W for itself and the others. Whose place is
whose does not stand in it, and from random weights training hardly finds out: 1200 steps of regression on
`wide_berth` took the squared error of agents within 0.45 m of a partner from 0.38-0.44 to 0.30-0.36 (also
with encoders of 64, 64 or 128 units), and 800 steps from this code to 0.13. It is read off as follows.

- The encoder's tanh units are steps at places along x and y, and along the way to the goal (place_units).
- An agent attends most to itself, so in every step's mixture its own sign wins: the layer's tanh, with a
  gain, restores its *own* thermometer whatever others send. In navigation attention falls with distance. In
  passage, where the team has an order, all of those who go before an agent and are about as high count the
  same, those behind it less: a partner counts before it is too near.
- Beside them stand channels whose mixture stays linear: sum_j alpha_ij p_j. What they differ by from the
  place that the own thermometer shows is sum_j alpha_ij (p_j - p_i), the direction in which partners are. In
  passage the same for the place in the order: it says that somebody who goes before is near.

The first decoder layer begins with these differences in some of its units. All parameters stay trainable, and
the architecture is one of the closed list.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from xmarl_baselines.distance_attention import DIRECTIONS
from xmarl_baselines.place_units import HEADINGS, PlaceUnits, navigation_units, passage_units
from xmarl_bench.errors import InputError
from xmarl_bench.policy import GraphPolicy

OWN_GAIN = 3.0  # of the layer on the steps: its tanh restores their signs
LEAK = 0.2  # slope of the layer's LeakyReLU below zero
LINEAR = 0.5  # of the layer on the position: small, its tanh leaves it as it is
QUIET = 0.1, 0.3  # what is left of torch's own attention weights, of the layer's and the receiver's
TOLD_APART = 32  # decoder units that begin with the difference of places
ORDER_TOLD, ORDER_GAINS = 24, (1.0, 4.0)  # and those that begin with the difference in the order, and gains
BEHIND = 1.67  # those behind score so much lower than the agent itself, relative to those before it
DECIDED = 0.03  # m of difference in the order from which on somebody is wholly before or behind
LEVEL, FADING = 0.2, 15.0  # m of difference in x and y up to which others count the same; fall beyond, 1/m


@torch.no_grad()
def code_places(policy: GraphPolicy, sharpness: float) -> None:
    """Set encoder, layer and part of the decoder, for observations of blind navigation or of blind passage.

    sharpness: how much lower than itself an agent scores a neighbour: in navigation at r m about
    1.9 * sharpness * r; in passage sharpness, if it goes before and is near. Raises InputError where the
    encoder is not one layer of enough tanh units, or the layer or decoder is too narrow.
    """
    code = _units_for(policy)
    n = len(code.units)
    told = torch.tensor(DIRECTIONS) @ code.place  # (channels, units): place along DIRECTIONS
    if code.order is not None:
        told = torch.cat([told, code.order[None], -code.order[None]])
    attended, bias, score = _attention(code, told, sharpness)
    linear = len(told) + (0 if attended is None else len(attended))
    _check(policy, n, linear)

    encoder = _first_layer(policy.encoder)
    encoder.weight[:n], encoder.bias[:n] = code.units[:, :-1], code.units[:, -1]
    gat = policy.gat
    for layer in (gat.lin_l, gat.lin_r):
        layer.weight[:linear] = 0.0
        layer.bias.zero_()
    gat.lin_l.weight[: len(told), :n] = told * LINEAR
    gat.lin_r.weight[linear:] *= QUIET[1]
    gat.att[..., linear:] *= QUIET[0]
    gat.att[..., :linear] = 0.0
    rows = slice(0, len(DIRECTIONS)) if attended is None else slice(len(told), linear)
    if attended is not None:
        gat.lin_l.weight[rows, :n] = attended
    gat.lin_r.weight[rows] = -gat.lin_l.weight[rows]
    gat.lin_r.bias[rows], gat.att[..., rows] = bias, score
    gain = torch.full((n,), OWN_GAIN)
    gain[-HEADINGS:] = 1.0
    gat.lin_l.weight[linear : linear + n] = torch.eye(n, gat.in_channels) * gain[:, None]
    gat.bias.zero_()

    decoder = _first_layer(policy.decoder)
    angle = torch.arange(TOLD_APART) * (2 * math.pi / TOLD_APART)
    towards = torch.stack([angle.cos(), angle.sin()], dim=1) * code.gain  # (units, 2)
    rows_of_place = _difference(towards, [0, 2], code.place, linear, gat.out_channels)
    decoder.weight[:TOLD_APART], decoder.bias[:TOLD_APART] = rows_of_place, 0.0
    if code.order is not None:
        gains = torch.linspace(*ORDER_GAINS, ORDER_TOLD // 2).repeat(2) * code.gain
        gains[ORDER_TOLD // 2 :] *= -1.0
        in_order = slice(TOLD_APART, TOLD_APART + ORDER_TOLD)
        decoder.weight[in_order] = _difference(
            gains[:, None], [len(DIRECTIONS)], code.order[None], linear, gat.out_channels
        )
        decoder.bias[in_order] = torch.linspace(-1.0, 1.0, ORDER_TOLD)


def _attention(
    code: PlaceUnits, told: Tensor, sharpness: float
) -> tuple[Tensor | None, Tensor | float, Tensor]:
    """Rows that only attention reads (None: those of the places), receiver's bias and weight of the score.

    A pair of rows (w, -w) with bias -b and weight -c contributes -0.8 c max(0, |w . (x_j - x_i)| - b), up to
    a constant: LeakyReLU's slopes are 1 and 0.2. Three rows w with biases d, 0, -d and weights that add up to
    0 make steps to either side of 0, which end at -d and d.
    """
    if code.order is None:
        return None, 0.0, torch.full((len(DIRECTIONS),), -sharpness / LINEAR)
    x, y = code.place
    rows = torch.stack([x, -x, y, -y, code.order, code.order, code.order])
    bias = torch.tensor([-LEVEL] * 4 + [DECIDED, 0.0, -DECIDED])
    before, behind = sharpness / DECIDED, BEHIND * sharpness / DECIDED
    bends = torch.tensor([behind, -before - behind, before])
    return rows, bias, torch.cat([torch.full((4,), -FADING), bends]) / (1.0 - LEAK)


def _difference(gains: Tensor, channels: list[int], shown: Tensor, linear: int, width: int) -> Tensor:
    """(units, width) decoder rows: gains (units, K) times mixture minus own, of K quantities.

    channels: where the pair of channels (forwards, backwards) of each begins. shown: (K, encoder's units).
    """
    rows = torch.zeros(len(gains), width)
    for quantity, channel in enumerate(channels):
        rows[:, channel] = gains[:, quantity] / (2 * LINEAR)
        rows[:, channel + 1] = -gains[:, quantity] / (2 * LINEAR)
    rows[:, linear : linear + shown.shape[1]] = -gains @ shown
    return rows


def _first_layer(layers: nn.Module) -> nn.Linear:
    return next(layer for layer in layers.modules() if isinstance(layer, nn.Linear))


def _units_for(policy: GraphPolicy) -> PlaceUnits:
    units = {6: navigation_units, 8: passage_units}.get(policy.architecture.obs_dim)
    if units is None:
        raise InputError(
            f"a code of places needs 6 or 8 observations (navigation, passage), got "
            f"{policy.architecture.obs_dim}: leave place_code at 0."
        )
    return units()


def _check(policy: GraphPolicy, n_units: int, linear: int) -> None:
    a = policy.architecture
    wide = len(a.encoder) == 1 and a.encoder[0] >= n_units and a.encoder_activation == "tanh"
    if not (wide and a.gat_width >= linear + n_units and a.gat_activation == "tanh"):
        raise InputError(
            f"a code of places needs an encoder of one layer of at least {n_units} tanh units and a tanh "
            f"layer of at least {linear + n_units}, got {a.encoder} {a.encoder_activation}, {a.gat_width} "
            f"{a.gat_activation}: change the architecture, or leave place_code at 0."
        )
    if not a.decoder or a.decoder[0] < TOLD_APART + ORDER_TOLD:
        raise InputError(
            f"a code of places needs a decoder of at least {TOLD_APART + ORDER_TOLD} units, got {a.decoder}."
        )
