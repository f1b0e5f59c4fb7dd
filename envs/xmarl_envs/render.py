"""Draws an episode with pygame: agents, targets, trails, and an explanation as arrows between agents."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pygame
from numpy.typing import ArrayLike, NDArray

from xmarl_envs.canvas import HEADER, LINE, Canvas
from xmarl_envs.colours import FAINT, INK, NEAR, PAPER, WALL, mix
from xmarl_envs.scene import Drawable, Scene
from xmarl_envs.task import Floats
from xmarl_envs.team_painter import TeamPainter

BACKDROP = 0.6  # m, half the width of a picture behind the agents
FPS = 20  # of a window: twice real time
ZOOM = 1.25  # the picture widens by this factor until the team fits
FADING = 60  # cycles after which a trail is at its faintest
FADES = 6  # segments of a trail, each of one tint
LENS = 240  # pixels, width of the inset that magnifies a crowded team ...
LEAST_MAGNIFIED = 1.3  # ... drawn only if it magnifies by at least this factor


class Renderer:
    """Pictures of one task.

    Args:
        task: what is drawn.
        window: show pictures in a window at `FPS`, instead of returning them.
        reach: m from the origin that every picture shows at least. By default a picture grows when the team
            leaves it.
        key: every picture has a third line above, which says what arrows and rings mean.
    """

    def __init__(
        self, task: Drawable, window: bool = False, reach: float = 0.0, *, key: bool = False
    ) -> None:
        self._task, self._key = task, key
        self._team = TeamPainter(task)
        header = HEADER + LINE * key
        self._canvas = Canvas(1.06 * (task.bound or task.spawn_half_width) + task.radius, header=header)
        self._usual, self._reach = self._canvas.half_width, reach
        self._lens = Canvas(1.0, LENS, header=0)
        self._window = window
        self._shown: pygame.Window | None = None
        self._closed = False
        self._clock = pygame.time.Clock()

    def draw(self, scene: Scene, mask: ArrayLike | None = None, title: str = "") -> NDArray[np.uint8] | None:
        """(HEADER + SIZE, SIZE, 3) uint8, LINE rows more with a key, or None when it went to the window.

        mask: (N, N) in [0, 1]; `mask[i, j]` becomes an arrow from j to i in j's colour, wider and darker the
        larger it is, and `mask[i, i]` a ring around i. title: replaces task and team size in the header.
        Raises ValueError if the mask has another shape or values outside [0, 1].
        """
        values = None if mask is None else self._checked(mask)
        if self._closed and self._window:
            return None
        picture = self._picture(scene, values, title)
        if not self._window:
            return np.ascontiguousarray(pygame.surfarray.array3d(picture).swapaxes(0, 1))
        if self._shown is None:
            pygame.display.init()
            self._shown = pygame.Window(self._task.name, picture.get_size())
        for event in pygame.event.get():
            if event.type == pygame.QUIT or (
                event.type == pygame.WINDOWCLOSE and event.window is self._shown
            ):
                self.close()
                return None
            if event.type == pygame.WINDOWCLOSE:  # another environment's
                pygame.event.post(event)
        self._shown.get_surface().blit(picture, (0, 0))
        self._shown.flip()
        self._clock.tick(FPS)
        return None

    def close(self) -> None:
        """Close the window. It stays closed; the episode goes on without it."""
        if self._shown is not None:
            self._shown.destroy()
        self._shown, self._closed = None, True

    def _picture(self, scene: Scene, mask: Floats | None, title: str) -> pygame.Surface:
        task, canvas = self._task, self._canvas
        now = scene.track[-1]
        if task.bound is None:
            reach = max(self._reach, float(np.abs(scene.track).max()) + task.radius)
            canvas.half_width = self._usual
            while canvas.half_width < reach:
                canvas.half_width *= ZOOM
        canvas.clear()
        canvas.grid()
        if scene.backdrop is not None:
            canvas.image(scene.backdrop, BACKDROP)
        self._draw_targets(scene.targets)
        for i in range(task.n_agents):
            self._draw_trail(scene.track[:, i], i)
        for centre in scene.walls:
            canvas.box(centre, task.wall_size, WALL)
        if task.bound is not None:
            canvas.frame(task.bound + task.radius, FAINT)  # where surfaces stop; `bound` is where centres do
        canvas.clear_header()
        self._team.draw(canvas, now, scene.collided, mask)
        plural = "s" if task.n_agents > 1 else ""
        canvas.header(0, title or f"{task.name}, {task.n_agents} agent{plural}", 22)
        canvas.header(1, _status(scene), 22)
        if self._key:
            self._team.draw_key(canvas)
        if mask is not None:
            self._draw_lens(scene, mask)
        return canvas.picture()

    def _draw_lens(self, scene: Scene, mask: Floats) -> None:
        """Draw a crowded team again, magnified, in the corner farthest from agents and targets."""
        canvas, lens, now = self._canvas, self._lens, scene.track[-1]
        lens.centre = (now.min(axis=0) + now.max(axis=0)) / 2
        lens.half_width = float(np.ptp(now, axis=0).max()) / 2 + 2.2 * self._task.radius
        if lens.pixels(1.0) < LEAST_MAGNIFIED * canvas.pixels(1.0):
            return
        lens.clear()
        self._team.draw(lens, now, scene.collided, mask)
        corners = [(right, top) for right in (True, False) for top in (True, False)]
        everything = np.concatenate([now, scene.targets])
        signs = np.where(corners, 1.0, -1.0) * canvas.half_width
        room = np.linalg.norm(everything - signs[:, None], axis=-1).min(axis=1)
        right, top = corners[int(room.argmax())]
        canvas.paste(lens, right, top, INK)

    def _draw_targets(self, targets: Floats) -> None:
        """Draw goals in their agents' colours, or a landmark with its sensing and covering ranges."""
        task, canvas, colours = self._task, self._canvas, self._team.colours
        sensing, covering = (getattr(task, f"{verb}_range", None) for verb in ("sensing", "covering"))
        if sensing is None and covering is None and len(targets) == task.n_agents:
            for i, centre in enumerate(targets):
                canvas.disc(centre, task.radius, mix(colours[i], PAPER, 0.85))
                canvas.ring(centre, task.radius, colours[i], 3)
                self._team.draw_number(canvas, centre, i, INK)
            return
        for centre in targets:
            if sensing is not None:
                canvas.disc(centre, sensing, NEAR)
            if covering is not None:
                canvas.ring(centre, covering, FAINT, 3)
            for slope in (1, -1):
                canvas.line(centre + task.radius * np.array([[-1, -slope], [1, slope]]), INK, 4)

    def _draw_trail(self, track: Floats, agent: int) -> None:
        colour = self._team.colours[agent]
        edges = np.linspace(max(0, len(track) - 1 - FADING), len(track) - 1, FADES + 1).astype(int)
        for age, (start, end) in enumerate([(0, edges[0]), *pairwise(edges)]):
            if end > start:
                tint = mix(PAPER, colour, 0.3 + 0.5 * age / FADES)
                self._canvas.line(track[start : end + 1], tint, 2.5)

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


def _status(scene: Scene) -> str:
    parts = [f"step {scene.cycle}", f"reward {scene.reward:+.2f}", f"return {scene.total:+.2f}", scene.ended]
    return "     ".join(part for part in parts if part)
