"""Draws an episode with pygame: goals, walls, ranges and numbered agents, in one colour per agent."""

from __future__ import annotations

import colorsys

import numpy as np
import pygame
from numpy.typing import NDArray

from xmarl_envs.task import State, Task

SIZE = 600  # pixels
OVERSAMPLING = 2  # drawn this much larger, then shrunk: pygame's own circles have jagged edges
PAPER, INK, WALL, FAINT, NEAR = (250, 250, 247), (40, 40, 46), (96, 96, 104), (190, 190, 190), (240, 236, 220)
# Okabe and Ito's colours, told apart by colour-blind readers too; larger teams go round the colour wheel.
COLOURS = [
    (230, 159, 0), (86, 180, 233), (0, 158, 115), (204, 121, 167),
    (0, 114, 178), (213, 94, 0), (240, 228, 66), (150, 150, 150),
]  # fmt: skip

Colour = tuple[int, int, int]


def agent_colours(n_agents: int) -> list[Colour]:
    """One colour per agent, red, green and blue in 0..255."""
    if n_agents <= len(COLOURS):
        return COLOURS[:n_agents]
    wheel = [colorsys.hsv_to_rgb(i / n_agents, 0.65, 0.85) for i in range(n_agents)]
    return [(int(255 * r), int(255 * g), int(255 * b)) for r, g, b in wheel]


class Renderer:
    """Pictures of one task. `window=True` shows them on screen and paces them to real time twice as fast."""

    def __init__(self, task: Task, window: bool = False) -> None:
        # Pictures need fonts only, no display: servers without a screen draw too.
        pygame.font.init()
        if window:
            pygame.display.init()
        self._task = task
        self._half_width = 1.15 * task.spawn_half_width + task.radius
        self._screen = pygame.display.set_mode((SIZE, SIZE)) if window else None
        self._canvas = pygame.Surface((OVERSAMPLING * SIZE, OVERSAMPLING * SIZE))
        self._font = pygame.font.Font(None, int(np.clip(1.3 * self._length(task.radius), 24, 48)))
        self._clock = pygame.time.Clock()
        self._colours = agent_colours(task.n_agents)

    def draw(self, state: State, episode: int) -> NDArray[np.uint8] | None:
        """Draw one episode of a batch; returns (SIZE, SIZE, 3) uint8, or None when it went to the window."""
        task = self._task
        self._canvas.fill(PAPER)
        has_goals = state.targets.shape[1] == task.n_agents
        for k, target in enumerate(state.targets[episode]):
            if has_goals:
                self._ring(target, task.radius, self._colours[k])
                self._label(target, str(k))
            else:
                self._landmark(target)
        for centre in state.walls[episode]:
            self._box(centre, task.wall_size, WALL)
        if task.bound is not None:
            self._border(task.bound + task.radius)  # where surfaces stop; `bound` is where centres do
        for i, position in enumerate(state.position[episode]):
            self._disc(position, task.radius, self._colours[i])
            self._label(position, str(i))
        picture = pygame.transform.smoothscale(self._canvas, (SIZE, SIZE))
        if self._screen is not None:
            pygame.event.pump()
            self._screen.blit(picture, (0, 0))
            pygame.display.flip()
            self._clock.tick(20)
            return None
        return np.ascontiguousarray(pygame.surfarray.array3d(picture).swapaxes(0, 1))

    def close(self) -> None:
        if self._screen is not None:
            pygame.display.quit()

    def _pixel(self, point: NDArray[np.float64]) -> tuple[int, int]:
        x, y = np.clip(point / self._half_width, -4.0, 4.0)
        size = OVERSAMPLING * SIZE
        return int(size * (0.5 + 0.5 * x)), int(size * (0.5 - 0.5 * y))

    def _length(self, metres: float) -> int:
        return max(1, round(metres / self._half_width * OVERSAMPLING * SIZE / 2))

    def _landmark(self, centre: NDArray[np.float64]) -> None:
        """A cross, with the range where it is sensed (tinted) and the one where it counts (outlined)."""
        sensing, covering = (getattr(self._task, f"{verb}_range", 0.0) for verb in ("sensing", "covering"))
        if sensing:
            pygame.draw.circle(self._canvas, NEAR, self._pixel(centre), self._length(sensing))
        if covering:
            self._ring(centre, covering, FAINT)
        (x, y), arm = self._pixel(centre), self._length(self._task.radius)
        for flip in (1, -1):
            pygame.draw.line(self._canvas, INK, (x - arm, y - flip * arm), (x + arm, y + flip * arm), 8)

    def _ring(self, centre: NDArray[np.float64], radius: float, colour: Colour) -> None:
        pygame.draw.circle(self._canvas, colour, self._pixel(centre), self._length(radius), 3 * OVERSAMPLING)

    def _disc(self, centre: NDArray[np.float64], radius: float, colour: Colour) -> None:
        pygame.draw.circle(self._canvas, colour, self._pixel(centre), self._length(radius))
        pygame.draw.circle(self._canvas, INK, self._pixel(centre), self._length(radius), OVERSAMPLING)

    def _label(self, centre: NDArray[np.float64], text: str) -> None:
        image = self._font.render(text, True, INK)
        self._canvas.blit(image, image.get_rect(center=self._pixel(centre)))

    def _box(self, centre: NDArray[np.float64], size: tuple[float, float], colour: Colour) -> None:
        rectangle = pygame.Rect(0, 0, self._length(size[0]), self._length(size[1]))
        rectangle.center = self._pixel(centre)
        pygame.draw.rect(self._canvas, colour, rectangle)

    def _border(self, half_width: float) -> None:
        """A frame, and paper outside of it: walls reach past the border."""
        left, top = self._pixel(np.array([-half_width, half_width]))
        size = 2 * self._length(half_width)
        frame = pygame.Rect(left, top, size, size)
        inside = self._canvas.subsurface(frame).copy()
        self._canvas.fill(PAPER)
        self._canvas.blit(inside, frame)
        pygame.draw.rect(self._canvas, FAINT, frame, OVERSAMPLING)
