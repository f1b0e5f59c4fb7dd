"""What the encoder's tanh units stand for under `place_code`: steps along lines through the observation.

A thermometer is a row of units tanh(sharpness * (x - c)), one for each place c along a line x = w . obs; half
the spacing of its places times their sum is x again. Source: Buckman et al. 2018, "Thermometer encoding".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from xmarl_envs.heuristics.ladder import FAR_FIRST, RIGHT_FIRST

HEADINGS = 8  # units that are nearly linear in the velocity

# Navigation: tanh(SHARP * (x - c)) for c = -REACH, -REACH + SPACING, ... m, and the same for y.
REACH, SPACING, SHARP = 1.29, 0.06, 12.0
# Steps along the way from the goal, in each axis: finer where it is short. Places, m, and sharpness, 1/m.
FROM_GOAL = (0.0, 0.04, 0.1, 0.2, 0.35, 0.6, 1.0)
FROM_GOAL_SHARP = (12.0, 12.0, 8.0, 6.0, 5.0, 3.0, 2.0)

# Passage, m. Beside the gap, on the way to the goal, and from the gap to the goal's side, each way: fine
# where an agent must be exact.
BESIDE_GAP = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.25, 1.5, 1.8)
TO_GOAL = (0.0, 0.015, 0.04, 0.08, 0.14, 0.25, 0.45, 0.8, 1.3)
TO_SIDE = (0.0, 0.03, 0.07, 0.12, 0.2, 0.3, 0.45, 0.65, 0.9, 1.2, 1.5, 1.8)
SHARP_TIMES_SPACING = 0.6


@dataclass(frozen=True)
class PlaceUnits:
    """Weights of the units, and how they are read. The last HEADINGS units show the velocity."""

    units: Tensor  # (units, D + 1): weights of the observation, and a bias
    place: Tensor  # (2, units): times what the units show it is an agent's x and y, m, up to a constant
    order: Tensor | None  # (units,): the same for who goes first; None where nobody does
    gain: float  # of the decoder units that begin with a difference of places, 1/m


def navigation_units() -> PlaceUnits:
    """For (position, velocity, position - goal)."""
    steps = torch.arange(-REACH, REACH + 1e-6, SPACING)
    near, sharp = torch.tensor(FROM_GOAL), torch.tensor(FROM_GOAL_SHARP)
    from_goal = torch.cat([-near[1:].flip(0), near]), torch.cat([sharp[1:].flip(0), sharp])
    units = torch.cat(
        [
            *(_along({axis: 1.0}, steps, torch.full_like(steps, SHARP), 6) for axis in (0, 1)),
            *(_along({entry: 1.0}, *from_goal, 6) for entry in (4, 5)),
            _headings(1.5, 6),
        ]
    )
    place = torch.zeros(2, len(units))
    place[0, : len(steps)] = place[1, len(steps) : 2 * len(steps)] = SPACING / 2
    return PlaceUnits(units, place, None, gain=8.0)


def passage_units() -> PlaceUnits:
    """For (position, velocity, goal - position, gap - position): x is told from the gap, y from the wall, and
    the order is `precedence` of the ladder."""
    aside, to_goal, to_side = _both_ways(BESIDE_GAP), _both_ways(TO_GOAL), _both_ways(TO_SIDE)
    height = torch.cat([torch.arange(-1.0, 0.201, 0.05), torch.arange(0.3, 1.01, 0.1)])
    height_of_goal = torch.arange(0.05, 1.06, 0.05)
    lines: list[tuple[dict[int, float], Tensor]] = [
        ({6: -1.0}, aside),
        ({1: 1.0}, height),
        ({4: 1.0}, to_goal),
        ({5: 1.0}, to_goal),
        ({1: 1.0, 5: 1.0}, height_of_goal),
        ({4: 1.0, 6: -1.0}, to_side),
    ]
    steps = [_along(line, places, SHARP_TIMES_SPACING / _spacing(places), 8) for line, places in lines]
    units = torch.cat([*steps, _headings(3.0, 8)])
    beside, up, _, _, goal_up, goal_aside = torch.tensor([len(step) for step in steps]).cumsum(0).tolist()
    place, order = torch.zeros(2, len(units)), torch.zeros(len(units))
    place[0, :beside], place[1, beside:up] = _spacing(aside) / 2, _spacing(height) / 2
    order[goal_up - len(height_of_goal) : goal_up] = _spacing(height_of_goal) / 2
    farther = FAR_FIRST * to_side.sign() + RIGHT_FIRST
    order[goal_up:goal_aside] = farther * _spacing(to_side) / 2
    return PlaceUnits(units, place, order, gain=20.0)


def _along(line: dict[int, float], places: Tensor, sharp: Tensor, obs_dim: int) -> Tensor:
    """(places, D + 1): one unit for each place along the sum of `line`'s entries times their factors."""
    units = torch.zeros(len(places), obs_dim + 1)
    for entry, factor in line.items():
        units[:, entry] = factor * sharp
    units[:, -1] = -sharp * places
    return units


def _headings(gain: float, obs_dim: int) -> Tensor:
    angle = torch.arange(HEADINGS) * (math.pi / HEADINGS)
    units = torch.zeros(HEADINGS, obs_dim + 1)
    units[:, 2], units[:, 3] = gain * angle.cos(), gain * angle.sin()
    return units


def _both_ways(places: tuple[float, ...]) -> Tensor:
    """Places from zero on, and the same below zero."""
    half = torch.tensor(places)
    return torch.cat([-half[1:].flip(0), half])


def _spacing(places: Tensor) -> Tensor:
    return torch.gradient(places)[0]
