"""Draws an episode with pygame: goals, walls, ranges and numbered agents, in one colour per agent."""

from __future__ import annotations

import colorsys
import os

import numpy as np
import pygame
from numpy.typing import NDArray

from xmarl_envs.task import State, Task

SIZE = 600  # pixels
PAPER, INK, WALL, FAINT = (250, 250, 247), (40, 40, 46), (96, 96, 104), (205, 205, 205)


class Renderer:
    """Pictures of one task. `window=True` shows them on screen and paces them to real time twice as fast."""

    def __init__(self, task: Task, window: bool = False) -> None:
        if not window:
            os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
        pygame.init()
        self._task = task
        self._half_width = 1.15 * task.spawn_half_width + task.radius
        self._screen = pygame.display.set_mode((SIZE, SIZE)) if window else None
        self._canvas = pygame.Surface((SIZE, SIZE))
        self._font = pygame.font.Font(None, 20)
        self._clock = pygame.time.Clock()
        self._colours = [
            tuple(int(255 * c) for c in colorsys.hsv_to_rgb(i / task.n_agents, 0.65, 0.85))
            for i in range(task.n_agents)
        ]

    def draw(self, state: State, episode: int) -> NDArray[np.uint8] | None:
        """Draw one episode of a batch; returns (SIZE, SIZE, 3) uint8, or None when it went to the window."""
        self._canvas.fill(PAPER)
        if self._task.bound is not None:
            self._box(np.zeros(2), (2 * self._task.bound, 2 * self._task.bound), FAINT, width=1)
        for centre in state.walls[episode]:
            self._box(centre, self._task.wall_size, WALL)
        shared = state.targets.shape[1] != self._task.n_agents
        for k, target in enumerate(state.targets[episode]):
            colour = INK if shared else self._colours[k]
            self._ring(target, self._task.radius, colour)
            for reach in ("covering_range", "sensing_range"):
                if hasattr(self._task, reach):
                    self._ring(target, getattr(self._task, reach), FAINT, width=1)
        for i, position in enumerate(state.position[episode]):
            self._disc(position, self._task.radius, self._colours[i], str(i))
        if self._screen is not None:
            pygame.event.pump()
            self._screen.blit(self._canvas, (0, 0))
            pygame.display.flip()
            self._clock.tick(20)
            return None
        return np.ascontiguousarray(pygame.surfarray.array3d(self._canvas).swapaxes(0, 1))

    def close(self) -> None:
        if self._screen is not None:
            pygame.display.quit()

    def _pixel(self, point: NDArray[np.float64]) -> tuple[int, int]:
        x, y = np.clip(point / self._half_width, -4.0, 4.0)
        return int(SIZE * (0.5 + 0.5 * x)), int(SIZE * (0.5 - 0.5 * y))

    def _length(self, metres: float) -> int:
        return max(1, round(metres / self._half_width * SIZE / 2))

    def _ring(self, centre: NDArray[np.float64], radius: float, colour: tuple[int, ...], width: int = 3) -> None:
        pygame.draw.circle(self._canvas, colour, self._pixel(centre), self._length(radius), width)

    def _disc(self, centre: NDArray[np.float64], radius: float, colour: tuple[int, ...], label: str) -> None:
        pygame.draw.circle(self._canvas, colour, self._pixel(centre), self._length(radius))
        text = self._font.render(label, True, INK)
        self._canvas.blit(text, text.get_rect(center=self._pixel(centre)))

    def _box(
        self, centre: NDArray[np.float64], size: tuple[float, float], colour: tuple[int, ...], width: int = 0
    ) -> None:
        rectangle = pygame.Rect(0, 0, self._length(size[0]), self._length(size[1]))
        rectangle.center = self._pixel(centre)
        pygame.draw.rect(self._canvas, colour, rectangle, width)
