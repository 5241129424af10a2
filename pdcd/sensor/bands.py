"""Work on a frame, band by band of its rows, on two cores.

Intermediate results of a band stay in the cache, and need no memory that the kernel must fetch and
clear first: on a large frame that costs more than the arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

_Piece = TypeVar("_Piece")
OfRows = Callable[[slice], NDArray[Any]]
"""Computes some rows of a frame."""

BAND_ROWS = 64
"""Rows of a band."""
_ALONE_ROWS = 512
"""Rows of a frame up to which threads cost more than a second core saves."""
THREADS = 2
"""Threads; NumPy, SciPy and OpenCV release the interpreter's lock while they compute."""


def run_in_bands(rows: int, work: Callable[[slice], None]) -> None:
    """Call `work` with every band of a frame of `rows` rows; bands must not write to each other."""
    bands = [slice(start, min(start + BAND_ROWS, rows)) for start in range(0, rows, BAND_ROWS)]
    _each(bands, work, rows)


def run_in_channels(image: NDArray[Any], work: Callable[[int], None]) -> None:
    """Call `work` with the number of every channel of an image (h, w, C); channels must not write
    to each other. It is for work that needs all rows at once, such as sums over cells."""
    _each(range(image.shape[2]), work, image.shape[0])


def _each(pieces: Iterable[_Piece], work: Callable[[_Piece], None], rows: int) -> None:
    """Call `work` with every piece of a frame of `rows` rows, on two cores where it is large."""
    if rows <= _ALONE_ROWS:
        for piece in pieces:
            work(piece)
        return
    with ThreadPoolExecutor(THREADS) as pool:
        for _ in pool.map(work, pieces):
            pass


def fill_in_bands(shape: tuple[int, ...], dtype: Any, make: OfRows) -> NDArray[Any]:
    """A frame (h, w, ...) whose bands `make` computes."""
    out = make_planar_image(shape, dtype)

    def fill(rows: slice) -> None:
        out[rows] = make(rows)

    run_in_bands(shape[0], fill)
    return out


def make_planar_image(shape: tuple[int, ...], dtype: Any = np.float64) -> NDArray[Any]:
    """An empty image (h, w, ...) whose channels lie one after the other in memory."""
    return np.moveaxis(np.empty((*shape[2:], *shape[:2]), dtype), (-2, -1), (0, 1))
