"""Makes docs/tasks.png, the three tasks side by side: `.venv/bin/python docs/make_pictures.py`."""

from __future__ import annotations

from pathlib import Path

import pygame
from xmarl_envs import TASKS, TaskParallelEnv, make_task

HERE = Path(__file__).parent
N_AGENTS, SEED = 5, 3
CAPTION, MARGIN = 44, 8  # pixels


def picture_of(name: str) -> pygame.Surface:
    """The first moment of an episode, under the task's name."""
    env = TaskParallelEnv(make_task(name, N_AGENTS), render_mode="rgb_array")
    env.reset(seed=SEED)
    frame = env.render()
    assert frame is not None
    height, width, _ = frame.shape
    panel = pygame.Surface((width, CAPTION + height))
    panel.fill((255, 255, 255))
    panel.blit(pygame.surfarray.make_surface(frame.swapaxes(0, 1)), (0, CAPTION))
    text = pygame.font.Font(None, 36).render(name, True, (40, 40, 46))
    panel.blit(text, text.get_rect(center=(width // 2, CAPTION // 2)))
    return panel


def main() -> None:
    panels = [picture_of(name) for name in TASKS]
    width, height = panels[0].get_size()
    sheet = pygame.Surface((len(panels) * (width + MARGIN) - MARGIN, height))
    sheet.fill((255, 255, 255))
    for k, panel in enumerate(panels):
        sheet.blit(panel, (k * (width + MARGIN), 0))
    pygame.image.save(sheet, HERE / "tasks.png")


if __name__ == "__main__":
    main()
