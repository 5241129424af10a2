"""Charts for people: points and lines over two axes, drawn into a picture."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]

WIDTH_PX, HEIGHT_PX = 900, 600
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 80, 20, 50, 60
"""Margins of the axes."""
PAPER, INK, FAINT = (250, 250, 250), (40, 40, 40), (215, 215, 215)
COLOURS = ((200, 40, 40), (30, 140, 50), (20, 90, 30), (40, 70, 200))
"""Red, both greens, blue."""
GREY = (120, 120, 120)
TICKS = 5
FONT = cv2.FONT_HERSHEY_SIMPLEX
OFTEN = 4000
"""Points beyond that many are thinned out."""

Colour = tuple[int, int, int]


@dataclass
class Chart:
    """One pair of axes.

    title : above it. across, down : what the axes are. x, y : (first, last) of either. Letters are
    ASCII. What lies beyond the axes is not drawn.
    """

    title: str
    across: str
    down: str
    x: tuple[float, float]
    y: tuple[float, float]
    picture: Bytes = field(init=False)

    def __post_init__(self) -> None:
        self.picture = np.full((HEIGHT_PX, WIDTH_PX, 3), PAPER, np.uint8)
        for share in np.linspace(0.0, 1.0, TICKS + 1):
            x, y = (first + share * (last - first) for first, last in (self.x, self.y))
            (col, _), (_, row) = self._at(x, self.y[0]), self._at(self.x[0], y)
            cv2.line(self.picture, (col, TOP_PX), (col, HEIGHT_PX - BOTTOM_PX), FAINT, 1)
            cv2.line(self.picture, (LEFT_PX, row), (WIDTH_PX - RIGHT_PX, row), FAINT, 1)
            self._write(f"{x:.4g}", (col - 18, HEIGHT_PX - BOTTOM_PX + 18))
            self._write(f"{y:.3g}", (LEFT_PX - 62, row + 4))
        self._write(self.title, (LEFT_PX, 30), 0.6)
        self._write(self.across, (WIDTH_PX // 2 - 60, HEIGHT_PX - 14))
        self._write(self.down, (8, TOP_PX - 10))

    def points(self, x: ArrayLike, y: ArrayLike, colour: Colour, radius_px: int = 3) -> None:
        """Dots at x, y (n,)."""
        for col, row in self._inside(x, y):
            cv2.circle(self.picture, (col, row), radius_px, colour, -1, cv2.LINE_AA)

    def line(self, x: ArrayLike, y: ArrayLike, colour: Colour) -> None:
        """Straight lines from point to point."""
        places = self._inside(x, y)
        for start, end in itertools.pairwise(places):
            cv2.line(self.picture, start, end, colour, 1, cv2.LINE_AA)

    def note(self, number: int, text: str, colour: Colour = INK) -> None:
        """A line of text in the upper left of the axes, counted from 0."""
        self._write(text, (LEFT_PX + 12, TOP_PX + 20 + 18 * number), colour=colour)

    def _inside(self, x: ArrayLike, y: ArrayLike) -> list[tuple[int, int]]:
        x, y = (np.atleast_1d(np.asarray(v, np.float64)).ravel() for v in (x, y))
        step = -(-x.size // OFTEN)
        with np.errstate(invalid="ignore"):
            good = (x >= self.x[0]) & (x <= self.x[1]) & (y >= self.y[0]) & (y <= self.y[1])
        kept = np.stack([x, y], axis=-1)[good][:: max(step, 1)]
        return [self._at(float(a), float(b)) for a, b in kept]

    def _at(self, x: float, y: float) -> tuple[int, int]:
        across = (x - self.x[0]) / (self.x[1] - self.x[0])
        up = (y - self.y[0]) / (self.y[1] - self.y[0])
        width, height = WIDTH_PX - LEFT_PX - RIGHT_PX, HEIGHT_PX - TOP_PX - BOTTOM_PX
        return round(LEFT_PX + across * width), round(TOP_PX + (1.0 - up) * height)

    def _write(
        self, text: str, at: tuple[int, int], size: float = 0.42, colour: Colour = INK
    ) -> None:
        cv2.putText(self.picture, text, at, FONT, size, colour, 1, cv2.LINE_AA)
