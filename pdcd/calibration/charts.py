"""Charts for people to look at: points, lines and words in a box, drawn with cv2 alone.

Letters are ASCII. Of many points some are drawn, evenly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Bytes = NDArray[np.uint8]
Colour = tuple[int, int, int]

INK, FAINT = (30, 30, 30), (190, 190, 190)
BLUE, RED, GREEN, GREY = (40, 90, 200), (200, 60, 40), (30, 140, 70), (120, 120, 120)
FONT = cv2.FONT_HERSHEY_SIMPLEX
CHANNELS = (RED, GREEN, (20, 90, 30), BLUE)
"""Red, both greens, blue."""
MARGINS = 70, 20, 46, 44
"""Pixels beside the box: left, right, above, below."""
LINE_PX = 18
"""Height of a line of words."""
MOST_POINTS = 4000


def sheet(width_px: int = 900, height_px: int = 600) -> Bytes:
    """An empty picture, (height, width, 3) uint8 RGB."""
    return np.full((height_px, width_px, 3), 255, np.uint8)


def write(on: Bytes, lines: Sequence[str], at: tuple[int, int], colour: Colour = INK) -> None:
    """Lines of words, one below the other, from the upper left."""
    for number, line in enumerate(lines):
        where = (at[0], at[1] + 13 + LINE_PX * number)
        cv2.putText(on, line, where, FONT, 0.45, colour, 1, cv2.LINE_AA)


@dataclass(frozen=True, eq=False)
class Chart:
    """A box of a sheet with two axes.

    on : the sheet. place : (left, top, width, height) in pixels, words included. x, y : ranges.
    """

    on: Bytes
    place: tuple[int, int, int, int]
    x: tuple[float, float]
    y: tuple[float, float]

    def frame(
        self, title: str, x_name: str, y_name: str, *, ticks: int = 5, columns: Sequence[str] = ()
    ) -> None:
        """Draw the box, its ticks and names. columns : what 1, 2, 3 along x are called."""
        left, top, right, bottom = self._box
        cv2.rectangle(self.on, (left, top), (right, bottom), INK, 1)
        for number, name in enumerate(columns):
            at = self.pixel(number + 1.0, self.y[0])
            self.words(name, (at[0] - 4 * len(name), bottom + 16))
        for value in () if columns else np.linspace(*self.x, ticks):
            at = self.pixel(value, self.y[0])
            self.words(f"{value:.3g}", (at[0] - 14, bottom + 16))
        for value in np.linspace(*self.y, ticks):
            row = self.pixel(self.x[0], value)[1]
            cv2.line(self.on, (left, row), (right, row), FAINT, 1)
            self.words(f"{value:.3g}", (left - 52, row + 4))
        self.words(title, (left, top - 26), 0.5)
        self.words(y_name, (left, top - 8))
        self.words(x_name, (left, bottom + 36))

    def pixel(self, x: float, y: float) -> tuple[int, int]:
        """Where a point lies on the sheet."""
        left, top, right, bottom = self._box
        across = (x - self.x[0]) / max(self.x[1] - self.x[0], 1e-300)
        up = (y - self.y[0]) / max(self.y[1] - self.y[0], 1e-300)
        column = left + float(np.clip(across, -0.05, 1.05)) * (right - left)
        return round(column), round(bottom - float(np.clip(up, -0.05, 1.05)) * (bottom - top))

    def points(self, x: ArrayLike, y: ArrayLike, colour: Colour, *, radius_px: int = 3) -> None:
        """A disc for each point; one that is not finite has none."""
        found = self._pixels(x, y)
        for at in found[:: 1 + len(found) // MOST_POINTS]:
            cv2.circle(self.on, at, radius_px, colour, -1, cv2.LINE_AA)

    def line(self, x: ArrayLike, y: ArrayLike, colour: Colour) -> None:
        """A line from point to point, past those that are not finite."""
        for first, second in pairwise(self._pixels(x, y)):
            cv2.line(self.on, first, second, colour, 1, cv2.LINE_AA)

    def bars(self, x: ArrayLike, y: ArrayLike, half: ArrayLike, colour: Colour) -> None:
        """An error bar for each point, `half` up and down."""
        for at, value, error in zip(np.ravel(x), np.ravel(y), np.ravel(half), strict=True):
            ends = self.pixel(at, value - error), self.pixel(at, value + error)
            cv2.line(self.on, *ends, colour, 1, cv2.LINE_AA)

    def words(self, text: str, at: tuple[int, int], size: float = 0.38) -> None:
        """Words at a pixel of the sheet."""
        cv2.putText(self.on, text, at, FONT, size, INK, 1, cv2.LINE_AA)

    def note(self, number: int, text: str, colour: Colour = INK) -> None:
        """A line of words in the upper left of the box, counted from 0."""
        left, top, _, _ = self._box
        write(self.on, [text], (left + 12, top + 8 + LINE_PX * number), colour)

    def legend(self, entries: Sequence[tuple[str, Colour]]) -> None:
        """What the colours mean, in the box's upper right corner."""
        _, top, right, _ = self._box
        for number, (text, colour) in enumerate(entries):
            row = top + 16 + 16 * number
            cv2.circle(self.on, (right - 150, row - 4), 4, colour, -1, cv2.LINE_AA)
            self.words(text, (right - 140, row))

    def _pixels(self, x: ArrayLike, y: ArrayLike) -> list[tuple[int, int]]:
        """Where the finite ones of some points lie."""
        both = np.stack([np.ravel(x), np.ravel(y)], axis=-1).astype(np.float64)
        return [self.pixel(*at) for at in both[np.isfinite(both).all(axis=-1)].tolist()]

    @property
    def _box(self) -> tuple[int, int, int, int]:
        left, top, width, height = self.place
        return (
            left + MARGINS[0], top + MARGINS[2], left + width - MARGINS[1],
            top + height - MARGINS[3],
        )  # fmt: skip
