"""Agents of any team have different colours, for colour-blind readers too."""

from __future__ import annotations

import numpy as np
import pytest
from xmarl_envs import make_task
from xmarl_envs.colours import FAINT, INK, NEAR, PAPER, WALL, Colour, agent_colours
from xmarl_envs.scene import Track
from xmarl_envs.vector_env import VectorEnv

from tests.envs.pictures import Floats, count, drawn


@pytest.mark.slow
@pytest.mark.parametrize("n_agents", [1, 9, 64])
def test_agents_of_any_team_have_different_colours(n_agents: int) -> None:
    colours = agent_colours(n_agents)
    assert len(set(colours)) == n_agents
    assert not set(colours) & {PAPER, INK, WALL, FAINT, NEAR}
    task = make_task("blind_discovery_v0", n_agents)
    env = VectorEnv(task)
    env.reset([0])
    everyone = np.full((n_agents, n_agents), 0.5)
    frame = drawn(task, Track(env.state).scene(), everyone if n_agents < 10 else None)
    assert all(count(frame, colour) > 5 for colour in colours)


# What people with each kind of colour blindness see of linear RGB: Machado, Oliveira and Fernandes, "A
# Physiologically-based Model for Simulation of Color Vision Deficiency" (2009), severity 1.
BLINDNESS = {
    "protanopia": (
        (0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998),
    ),
    "deuteranopia": (
        (0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.01182, 0.04294, 0.968881),
    ),
    "tritanopia": (
        (1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602), (0.004733, 0.691367, 0.3039),
    ),
}  # fmt: skip
XYZ = ((0.4124564, 0.3575761, 0.1804375), (0.2126729, 0.7151522, 0.072175), (0.0193339, 0.119192, 0.9503041))


def lab(colours: list[Colour], blindness: tuple[tuple[float, ...], ...]) -> Floats:
    """CIE L*a*b* of sRGB colours as perceived with a colour blindness."""
    srgb = np.array(colours) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.array(blindness).T, 0, 1) @ np.array(XYZ).T / [0.95047, 1.0, 1.08883]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


@pytest.mark.parametrize(("n_agents", "least"), [(8, 15.0), (16, 6.0)])
@pytest.mark.parametrize("blindness", BLINDNESS)
def test_colour_blind_readers_can_tell_the_colours_apart(blindness: str, n_agents: int, least: float) -> None:
    """By CIE 1976 differences, of which 2.3 is just noticeable."""
    seen = lab(agent_colours(n_agents), BLINDNESS[blindness])
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=-1)[np.triu_indices(n_agents, 1)]
    assert apart.min() > least
