"""Draws shapes in metres on a pygame surface, twice as large and then shrunk: pygame's edges are jagged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pygame
from numpy.typing import NDArray

from xmarl_envs.colours import GRID, INK, PAPER, Colour
from xmarl_envs.task import Floats

SIZE = 640  # pixels, width of a picture and height of its world
HEADER = 64  # pixels above the world, of two lines; video codecs need both to be multiples of 16
LINE = 32  # pixels of a line of the header
OVERSAMPLING = 2
GRID_SPACING = 0.5  # m


class Canvas:
    """A square of the plane around `centre`, with a header of text above it.

    Coordinates and lengths are metres, y up; widths of lines and sizes of fonts are pixels of the picture.
    """

    def __init__(self, half_width: float, size: int = SIZE, header: int = HEADER) -> None:
        pygame.font.init()  # fonts need no display, so servers without a screen can draw
        self.half_width = half_width
        self.centre: Floats = np.zeros(2)
        self._size, self._header = size, header
        pixels = (OVERSAMPLING * size, OVERSAMPLING * (size + header))
        self._surface = pygame.Surface(pixels)
        self._fonts: dict[int, pygame.font.Font] = {}

    def clear(self) -> None:
        self._surface.fill(PAPER)

    def grid(self) -> None:
        for k in range(-int(self.half_width / GRID_SPACING), int(self.half_width / GRID_SPACING) + 1):
            at, reach = k * GRID_SPACING, self.half_width
            self.line(np.array([[at, -reach], [at, reach]]), GRID, 1)
            self.line(np.array([[-reach, at], [reach, at]]), GRID, 1)

    def picture(self) -> pygame.Surface:
        """(size, header + size) pixels."""
        return pygame.transform.smoothscale(self._surface, (self._size, self._size + self._header))

    def paste(self, other: Canvas, right: bool, top: bool, colour: Colour) -> None:
        """Draw another canvas, with a frame, into a corner of the world."""
        margin, size = 10 * OVERSAMPLING, OVERSAMPLING * self._size
        place = other._surface.get_rect()
        place.x = size - margin - place.width if right else margin
        place.y = OVERSAMPLING * self._header + (margin if top else size - margin - place.height)
        self._surface.blit(other._surface, place)
        pygame.draw.rect(self._surface, colour, place, OVERSAMPLING)

    def pixels(self, metres: float) -> float:
        """Convert a length from metres to pixels of the picture."""
        return metres / self.half_width * self._size / 2

    def metres(self, pixels: float) -> float:
        """Convert a length from pixels of the picture to metres."""
        return pixels * 2 * self.half_width / self._size

    def disc(self, centre: Floats, radius: float, colour: Colour) -> None:
        pygame.draw.circle(self._surface, colour, self._at(centre), self._length(radius))

    def ring(self, centre: Floats, radius: float, colour: Colour, width: float) -> None:
        """Draw a circle whose line lies inside the radius."""
        line = max(1, round(OVERSAMPLING * width))
        pygame.draw.circle(self._surface, colour, self._at(centre), self._length(radius), line)

    def line(self, points: Floats, colour: Colour, width: float) -> None:
        """Draw a line through points (P, 2)."""
        pygame.draw.lines(
            self._surface,
            colour,
            False,
            [self._at(p) for p in points],
            max(1, round(OVERSAMPLING * width)),
        )

    def polygon(self, points: Floats, colour: Colour) -> None:
        """Fill the polygon of points (P, 2)."""
        pygame.draw.polygon(self._surface, colour, [self._at(p) for p in points])

    def edge(self, points: Floats, colour: Colour) -> None:
        """Draw the outline of the polygon of points (P, 2), one pixel wide."""
        pygame.draw.lines(self._surface, colour, True, [self._at(p) for p in points], OVERSAMPLING)

    def box(self, centre: Floats, size: Sequence[float], colour: Colour) -> None:
        half = np.array(size) / 2
        self.polygon(centre + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), colour)

    def frame(self, half_width: float, colour: Colour) -> None:
        """Draw a square around the origin and clear everything outside it."""
        (left, top), size = self._at(np.array([-half_width, half_width])), 2 * self._length(half_width)
        square = pygame.Rect(left, top, size, size)
        inside = self._surface.subsurface(square).copy()
        self._surface.fill(PAPER)
        self._surface.blit(inside, square)
        pygame.draw.rect(self._surface, colour, square, OVERSAMPLING)

    def image(self, pixels: NDArray[np.uint8], half_width: float) -> None:
        """Draw a picture (H, W, 3) around the origin, as far as `half_width` to both of its longer sides."""
        whole = pygame.surfarray.make_surface(pixels.swapaxes(0, 1))
        factor = 2 * self._length(half_width) / max(whole.get_size())
        shown = pygame.transform.smoothscale(
            whole, [max(1, round(factor * side)) for side in whole.get_size()]
        )
        self._surface.blit(shown, shown.get_rect(center=self._at(np.zeros(2))))

    def label(self, centre: Floats, text: str, size: float, colour: Colour) -> None:
        image = self._font(size).render(text, True, colour)
        self._surface.blit(image, image.get_rect(center=self._at(centre)))

    def text(self, left: Floats, text: str, size: float, colour: Colour) -> None:
        """Write text that begins at `left`, its middle."""
        image = self._font(size).render(text, True, colour)
        self._surface.blit(image, image.get_rect(midleft=self._at(left)))

    def header(self, line: int, text: str, size: float) -> None:
        """Write text into a line above the world, counted from 0, shrunk to fit."""
        margin, middle = 12 * OVERSAMPLING, round((18 + 28 * line) * OVERSAMPLING)
        room = OVERSAMPLING * self._size - 2 * margin
        size *= min(1.0, room / self._font(size).size(text)[0])
        image = self._font(size).render(text, True, INK)
        self._surface.blit(image, image.get_rect(left=margin, centery=middle))

    def clear_header(self) -> None:
        """Clear what was drawn above the world's upper edge."""
        self._surface.fill(PAPER, pygame.Rect(0, 0, OVERSAMPLING * self._size, OVERSAMPLING * self._header))

    def _font(self, size: float) -> pygame.font.Font:
        pixels = round(OVERSAMPLING * size)
        if pixels not in self._fonts:
            self._fonts[pixels] = pygame.font.Font(None, pixels)
        return self._fonts[pixels]

    def _at(self, point: Floats) -> tuple[int, int]:
        x, y = np.clip((point - self.centre) / self.half_width, -4.0, 4.0)
        size = OVERSAMPLING * self._size
        return round(size * (0.5 + 0.5 * x)), round(size * (0.5 - 0.5 * y)) + OVERSAMPLING * self._header

    def _length(self, metres: float) -> int:
        return max(1, round(OVERSAMPLING * self.pixels(metres)))
