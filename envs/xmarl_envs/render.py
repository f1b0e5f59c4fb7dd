"""Draws an episode with pygame: agents in colours of their own, what they head for, where they came from, and
an explanation as arrows between them.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from xmarl_envs.canvas import Canvas
from xmarl_envs.colours import FAINT, INK, NEAR, PAPER, WALL, Colour, agent_colours, mix, readable_on
from xmarl_envs.scene import Scene
from xmarl_envs.task import Floats, Task

FPS = 20  # of a window: twice real time
ZOOM = 1.25  # a team that leaves the picture makes it wider by this factor, as often as needed
FADING = 60  # cycles after which a trail is at its faintest
FADES = 6  # stretches of a trail, each of one tint
SMALL = 7.5  # pixels; the number of a smaller agent stands beside it
FAINTEST = 0.05  # masks below it are not drawn; at 64 agents there are 4096
LEGEND = (0.1, 0.5, 1.0)


class Renderer:
    """Pictures of one task.

    Args:
        task: what is drawn.
        window: show pictures in a window at `FPS`, instead of returning them.
        reach: m from the origin that every picture shows at least. By default a picture grows when the team
            leaves it.
    """

    def __init__(self, task: Task, window: bool = False, reach: float = 0.0) -> None:
        self._task = task
        self._colours = agent_colours(task.n_agents)
        self._canvas = Canvas(1.06 * (task.bound or task.spawn_half_width) + task.radius)
        self._usual, self._reach = self._canvas.half_width, reach
        self._window = window
        self._screen: pygame.Surface | None = None
        self._clock = pygame.time.Clock()

    def draw(self, scene: Scene, mask: ArrayLike | None = None, title: str = "") -> NDArray[np.uint8] | None:
        """(HEADER + SIZE, SIZE, 3) uint8, or None when it went to the window.

        mask: (N, N) in [0, 1]; `mask[i, j]` becomes an arrow from j to i, wider and darker the larger it is,
        and `mask[i, i]` a ring around i. title: what stands above instead of task and team size.
        Raises ValueError for a mask of another shape or with values outside [0, 1].
        """
        values = None if mask is None else self._checked(mask)
        picture = self._picture(scene, values, title)
        if not self._window:
            return np.ascontiguousarray(pygame.surfarray.array3d(picture).swapaxes(0, 1))
        if self._screen is None:
            pygame.display.init()
            self._screen = pygame.display.set_mode(picture.get_size())
            pygame.display.set_caption(self._task.name)
        # A window that was closed stays closed; the episode goes on without it.
        if pygame.display.get_init() and not any(e.type == pygame.QUIT for e in pygame.event.get()):
            self._screen.blit(picture, (0, 0))
            pygame.display.flip()
            self._clock.tick(FPS)
        else:
            pygame.display.quit()
        return None

    def close(self) -> None:
        if self._screen is not None:
            pygame.display.quit()

    def _picture(self, scene: Scene, mask: Floats | None, title: str) -> pygame.Surface:
        task, canvas = self._task, self._canvas
        now = scene.track[-1]
        if task.bound is None:
            reach = max(self._reach, float(np.abs(scene.track).max()) + task.radius)
            canvas.half_width = self._usual
            while canvas.half_width < reach:
                canvas.half_width *= ZOOM
        canvas.clear()
        self._draw_targets(scene.targets)
        for i in range(task.n_agents):
            self._draw_trail(scene.track[:, i], i)
        for centre in scene.walls:
            canvas.box(centre, task.wall_size, WALL)
        if task.bound is not None:
            canvas.frame(task.bound + task.radius, FAINT)  # where surfaces stop; `bound` is where centres do
        canvas.clear_header()
        for centre in now[scene.collided]:
            self._draw_star(centre)
        if mask is not None:
            self._draw_mask(now, mask)
            self._draw_legend()
            canvas.blend()
        for i, centre in enumerate(now):
            canvas.disc(centre, task.radius, INK)
            canvas.disc(centre, task.radius - canvas.metres(1), self._colours[i])
            self._draw_number(centre, i, readable_on(self._colours[i]))
        plural = "s" if task.n_agents > 1 else ""
        canvas.header(0, title or f"{task.name}, {task.n_agents} agent{plural}", 22)
        canvas.header(1, _status(scene), 22)
        return canvas.picture()

    def _draw_targets(self, targets: Floats) -> None:
        """Goals in the colours of their agents; a landmark with the ranges it is sensed and covered in."""
        task, canvas = self._task, self._canvas
        sensing, covering = (getattr(task, f"{verb}_range", None) for verb in ("sensing", "covering"))
        if sensing is None and covering is None and len(targets) == task.n_agents:
            for i, centre in enumerate(targets):
                canvas.disc(centre, task.radius, mix(self._colours[i], PAPER, 0.85))
                canvas.ring(centre, task.radius, self._colours[i], 3)
                self._draw_number(centre, i, INK)
            return
        for centre in targets:
            if sensing is not None:
                canvas.disc(centre, sensing, NEAR)
            if covering is not None:
                canvas.ring(centre, covering, FAINT, 3)
            for slope in (1, -1):
                canvas.line(centre + task.radius * np.array([[-1, -slope], [1, slope]]), INK, 4)

    def _draw_number(self, centre: Floats, agent: int, colour: Colour) -> None:
        radius = self._canvas.pixels(self._task.radius)
        if radius >= SMALL:
            self._canvas.label(centre, str(agent), float(np.clip(1.5 * radius, 13, 26)), colour)
        else:  # beside a disc that it would hide
            aside = self._canvas.metres(radius + 4)
            self._canvas.label(centre + aside, str(agent), 13, INK)

    def _draw_trail(self, track: Floats, agent: int) -> None:
        colour = self._colours[agent]
        edges = np.linspace(max(0, len(track) - 1 - FADING), len(track) - 1, FADES + 1).astype(int)
        for age, (start, end) in enumerate([(0, edges[0]), *pairwise(edges)]):
            if end > start:
                tint = mix(PAPER, colour, 0.3 + 0.5 * age / FADES)
                self._canvas.line(track[start : end + 1], tint, 2.5)

    def _draw_star(self, centre: Floats) -> None:
        """Spikes around who collides: a shape, for red alone is not seen by everybody."""
        angle = np.arange(24) * np.pi / 12
        radius = self._task.radius * np.where(np.arange(24) % 2, 1.1, 1.45)
        self._canvas.polygon(
            centre + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), (214, 39, 40)
        )

    def _draw_mask(self, position: Floats, mask: Floats) -> None:
        for k in np.argsort(mask, axis=None, kind="stable"):  # the largest are drawn last, above the others
            receiver, sender = divmod(int(k), len(mask))
            value = float(mask[receiver, sender])
            if value < FAINTEST:
                continue
            if receiver == sender:
                width = self._width(value)
                radius = self._task.radius + self._canvas.metres(2 + width)
                self._canvas.ring(position[receiver], radius, INK, width, _opacity(value))
            else:
                self._draw_arrow(position[sender], position[receiver], value, self._task.radius)

    def _draw_arrow(self, start: Floats, end: Floats, value: float, gap: float) -> None:
        """From disc to disc, beside the arrow that goes the other way."""
        length = float(np.hypot(*(end - start)))
        if length == 0.0:
            return
        along = (end - start) / length
        aside = np.array([along[1], -along[0]])
        pixel = self._canvas.metres(1)
        half, head = self._width(value) / 2 * pixel, self._head(value) * pixel
        gap = min(gap, 0.3 * length)
        start, end = start + gap * along + head * aside, end - gap * along + head * aside
        neck = end - min(2 * head, length - 2 * gap) * along
        outline = [
            start - half * aside, neck - half * aside, neck - head * aside, end,
            neck + head * aside, neck + half * aside, start + half * aside,
        ]  # fmt: skip
        self._canvas.polygon(np.array(outline), INK, _opacity(value))

    def _draw_legend(self) -> None:
        canvas = self._canvas
        pixel = canvas.metres(1)
        y = canvas.half_width + 18 * pixel
        for k, value in enumerate(LEGEND):
            x = canvas.half_width - (210 - 74 * k) * pixel
            on = y + self._head(value) * pixel  # arrows lie beside their line
            self._draw_arrow(np.array([x, on]), np.array([x + 30 * pixel, on]), value, 0.0)
            canvas.label(np.array([x + 46 * pixel, y]), f"{value:g}", 20, INK)

    def _width(self, value: float) -> float:
        """Pixels of an arrow or ring: less in large teams, and at most about an agent's radius."""
        return 1.0 + value * min(
            8.0, 1.5 + 30.0 / self._task.n_agents, self._canvas.pixels(self._task.radius)
        )

    def _head(self, value: float) -> float:
        """Pixels from an arrow's middle to the side of its head."""
        return self._width(value) / 2 + 5

    def _checked(self, mask: ArrayLike) -> Floats:
        values = np.asarray(mask, dtype=np.float64)
        expected = (self._task.n_agents, self._task.n_agents)
        if values.shape != expected:
            raise ValueError(f"a mask to draw must have shape {expected}, got {values.shape}.")
        if not (np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= 1.0):
            raise ValueError(
                f"a mask to draw must lie in [0, 1], got values from {values.min()} to {values.max()}."
            )
        return values


def _opacity(value: float) -> float:
    """Its square root: the attention of a large team is small everywhere, and still to be seen."""
    return min(float(np.sqrt(value)), 0.999)  # 1 would be drawn below the translucent ones


def _status(scene: Scene) -> str:
    parts = [f"step {scene.cycle}", f"reward {scene.reward:+.2f}", f"return {scene.total:+.2f}", scene.ended]
    return "     ".join(part for part in parts if part)
