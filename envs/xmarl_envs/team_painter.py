"""Draws a team and its explanation: numbered discs, arrows from sender to receiver, rings for own edges."""

from __future__ import annotations

import numpy as np

from xmarl_envs.canvas import Canvas
from xmarl_envs.colours import INK, PAPER, Colour, agent_colours, mix, readable_on
from xmarl_envs.scene import Drawable
from xmarl_envs.task import Bools, Floats

STAR = (214, 39, 40)
FAINTEST = 0.05  # smaller mask values are not drawn: 64 agents have 4096
LEGEND = (0.1, 0.5, 1.0)
SMALL = 7.5  # pixels; the number of a smaller agent is drawn beside it


class TeamPainter:
    """Draws the team of one task on any canvas."""

    def __init__(self, task: Drawable) -> None:
        self._radius = task.radius
        self._n_agents = task.n_agents
        self.colours = agent_colours(task.n_agents)

    def draw(self, canvas: Canvas, position: Floats, collided: Bools, mask: Floats | None) -> None:
        """position: (N, 2) m; mask: (N, N) in [0, 1], drawn below the discs."""
        if mask is not None:
            self._draw_mask(canvas, position, mask)
        for centre in position[collided]:
            self._draw_star(canvas, centre)
        for i, centre in enumerate(position):
            canvas.disc(centre, self._radius, INK)
            canvas.disc(centre, self._radius - canvas.metres(1), self.colours[i])
            self.draw_number(canvas, centre, i, readable_on(self.colours[i]))

    def draw_number(self, canvas: Canvas, centre: Floats, agent: int, colour: Colour) -> None:
        radius = canvas.pixels(self._radius)
        if radius >= SMALL:
            canvas.label(centre, str(agent), float(np.clip(1.5 * radius, 13, 26)), colour)
        else:  # on the disc it would hide it
            canvas.label(centre + canvas.metres(radius + 4), str(agent), 13, INK)

    def draw_key(self, canvas: Canvas) -> None:
        """Say in the header's third line what arrows and rings mean, with arrows of three mask values."""
        pixel = canvas.metres(1)
        y = canvas.half_width + 16 * pixel

        def at(x: float, above: float = 0.0) -> Floats:
            return np.array([x * pixel - canvas.half_width, y + above * pixel])

        canvas.text(at(12), "arrow: message, sender's colour; thickness = weight", 18, INK)
        for k, value in enumerate(LEGEND):
            on = self._head(canvas, value)  # arrows are offset from their line
            self._draw_arrow(canvas, at(346 + 58 * k, on), at(374 + 58 * k, on), 0, value, 0.0)
            canvas.text(at(378 + 58 * k), f"{value:g}", 18, INK)
        self._draw_ring(canvas, at(532), 0, 0.5, 4 * pixel)
        canvas.text(at(548), "own message", 18, INK)

    def _draw_star(self, canvas: Canvas, centre: Floats) -> None:
        """Draw spikes around a colliding agent: a shape, because not everybody can see red."""
        angle = np.arange(24) * np.pi / 12
        radius = self._radius * np.where(np.arange(24) % 2, 1.1, 1.45)
        spikes = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        canvas.polygon(centre + spikes, STAR)

    def _draw_mask(self, canvas: Canvas, position: Floats, mask: Floats) -> None:
        for k in np.argsort(mask, axis=None, kind="stable"):  # the largest are drawn last, above the others
            receiver, sender = divmod(int(k), len(mask))
            value = float(mask[receiver, sender])
            if value < FAINTEST:
                continue
            if receiver == sender:
                self._draw_ring(canvas, position[receiver], receiver, value, self._radius)
            else:
                self._draw_arrow(canvas, position[sender], position[receiver], sender, value, self._radius)

    def _draw_ring(self, canvas: Canvas, centre: Floats, agent: int, value: float, inner: float) -> None:
        """Draw a ring around `inner` m, with a dark edge outside."""
        width = self._width(canvas, value)
        radius = inner + canvas.metres(3 + width)
        canvas.ring(centre, radius, _tint(mix(self.colours[agent], INK, 0.7), value), width)
        canvas.ring(centre, radius - canvas.metres(1), _tint(self.colours[agent], value), max(1.0, width - 1))

    def _draw_arrow(
        self, canvas: Canvas, start: Floats, end: Floats, sender: int, value: float, gap: float
    ) -> None:
        """Draw an arrow from disc to disc in the sender's colour, with a dark edge, beside its opposite."""
        length = float(np.hypot(*(end - start)))
        if length == 0.0:
            return
        along = (end - start) / length
        aside = np.array([along[1], -along[0]])
        gap = min(gap, 0.3 * length)
        head = canvas.metres(self._head(canvas, value))
        shrunk = min(1.0, 0.4 * (length - 2 * gap) / head)  # where discs nearly touch
        head, half = shrunk * head, shrunk * canvas.metres(self._width(canvas, value)) / 2
        start, end = start + gap * along + head * aside, end - gap * along + head * aside
        neck = end - 2 * head * along
        outline = [
            start - half * aside, neck - half * aside, neck - head * aside, end,
            neck + head * aside, neck + half * aside, start + half * aside,
        ]  # fmt: skip
        canvas.polygon(np.array(outline), _tint(self.colours[sender], value))
        canvas.edge(np.array(outline), _tint(mix(self.colours[sender], INK, 0.7), value))

    def _width(self, canvas: Canvas, value: float) -> float:
        """Width in pixels of an arrow or ring: smaller in large teams, at most about an agent's radius."""
        widest = min(8.0, 1.5 + 30.0 / self._n_agents, canvas.pixels(self._radius))
        return 1.0 + value * widest

    def _head(self, canvas: Canvas, value: float) -> float:
        """Pixels from an arrow's middle to the side of its head."""
        return self._width(canvas, value) / 2 + 5


def _tint(colour: Colour, value: float) -> Colour:
    """Pale for small values, by their square root: small weights in a large team stay visible."""
    return mix(PAPER, colour, float(np.sqrt(value)))
