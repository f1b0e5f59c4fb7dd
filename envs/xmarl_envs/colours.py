"""Colours of pictures, as (red, green, blue) in 0..255."""

from __future__ import annotations

Colour = tuple[int, int, int]

PAPER: Colour = (250, 250, 247)
INK: Colour = (40, 40, 46)
WALL: Colour = (96, 96, 104)
FAINT: Colour = (190, 190, 190)
GRID: Colour = (236, 236, 232)
NEAR: Colour = (240, 236, 220)

# Okabe and Ito's colours ("Color Universal Design", 2008), which colour-blind readers can tell apart. Their
# black is a dark grey here, so that numbers on it are readable.
HUES: tuple[Colour, ...] = (
    (230, 159, 0), (86, 180, 233), (0, 158, 115), (204, 121, 167),
    (0, 114, 178), (213, 94, 0), (240, 228, 66), (70, 70, 70),
)  # fmt: skip
# Agents 8 to 63 take the same hues, lighter or darker: not everybody could tell more hues apart.
SHADES = (0.0, 0.5, -0.45, 0.25, -0.25, 0.7, -0.65, -0.8)


def agent_colours(n_agents: int) -> list[Colour]:
    """One colour per agent, all different up to 64. The first N do not depend on N."""
    rounds = [SHADES[(i // len(HUES)) % len(SHADES)] for i in range(n_agents)]
    return [
        mix(HUES[i % len(HUES)], PAPER if shade > 0 else INK, abs(shade)) for i, shade in enumerate(rounds)
    ]


def mix(colour: Colour, other: Colour, part: float) -> Colour:
    """Blend two colours: part 0 gives `colour`, 1 gives `other`."""
    red, green, blue = (round(a + part * (b - a)) for a, b in zip(colour, other, strict=True))
    return red, green, blue


def readable_on(colour: Colour) -> Colour:
    """Ink or paper, whichever has more contrast (relative luminance of WCAG 2)."""
    red, green, blue = ((c / 255) ** 2.2 for c in colour)
    return PAPER if 0.2126 * red + 0.7152 * green + 0.0722 * blue < 0.18 else INK
