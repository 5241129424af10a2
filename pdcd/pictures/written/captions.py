"""The strip below a preview: its name, how much it was brightened, and a scale of greys."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]

HEIGHT_PX = 48
PAPER, INK, FAINT = 24, 225, 150
"""Greys of the strip and its letters."""
STEP_PX, STEP_HEIGHT_PX = 52, 20
"""Size of one grey of the scale."""
FONT = cv2.FONT_HERSHEY_SIMPLEX
MARGIN_PX = 10


def strip(
    width_px: int, title: str, notes: Sequence[str], greys: Sequence[tuple[int, str]]
) -> Bytes:
    """A caption, (HEIGHT_PX, width_px, 3) uint8.

    title, notes : ASCII; the notes are smaller, below the title, apart from each other.
    greys : pixel values from dark to bright, and what is written below each.
    """
    drawn = np.full((HEIGHT_PX, width_px), PAPER, np.uint8)
    left = width_px - MARGIN_PX - STEP_PX * len(greys)
    for number, (grey, words) in enumerate(greys):
        begin = left + number * STEP_PX
        drawn[6 : 6 + STEP_HEIGHT_PX, begin : begin + STEP_PX] = grey
        (across, _), _ = cv2.getTextSize(words, FONT, 0.38, 1)
        _write(drawn, words, (begin + (STEP_PX - across) // 2, HEIGHT_PX - 8), 0.38, FAINT)
    room = drawn[:, : left - MARGIN_PX]  # what does not fit must not run into the scale
    _write(room, title, (MARGIN_PX, 21), 0.6, INK)
    _write(room, "   ".join(notes), (MARGIN_PX, HEIGHT_PX - 9), 0.4, FAINT)
    return np.repeat(drawn[..., None], 3, axis=2)


def _write(on: Bytes, words: str, at: tuple[int, int], size: float, grey: int) -> None:
    cv2.putText(on, words, at, FONT, size, grey, 1, cv2.LINE_AA)
