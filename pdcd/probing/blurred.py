"""Direct light that reaches the mask blurred: what windows see of lit halves of cells.

Relay and focus spread a point of the scene over the mask by a Gaussian. For windows as small as
that it decides how much direct light goes past the right one. Both panels are constant on
rectangles, so that the time for which a point is lit and seen, averaged over a window's part of a
cell, is a weighted sum over the rectangles of light around it, with weights in closed form:

    integral over x in [a, b], y in [c, d] of G(x - y) = S(b-c) - S(a-c) - S(b-d) + S(a-d)

with ``S(t) = t Phi(t/s) + s phi(t/s)``, along either axis.

The light around is taken as if the scene reflected there what it does in the middle.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.panels.lattice import Lattice, Piece

Floats = NDArray[np.float64]

REACH = 9.0
"""Standard deviations beyond which nothing of a Gaussian is left that float64 would notice."""


class Blur:
    """Blur of the light on the mask, over the cells of a lattice.

    sigma_cells : (rows, cols), standard deviation of the Gaussian in cells along either axis.
    """

    def __init__(self, lattice: Lattice, sigma_cells: tuple[float, float]) -> None:
        self._lattice, self._sigma = lattice, sigma_cells

    @cached_property
    def shares(self) -> tuple[list[Floats], list[Floats]]:
        """For each piece of a cell, along rows and columns: how much of the light of each half (or
        whole) cell falls on it, (halves * cells, cells)."""
        rows, cols = self._lattice.grid
        down, right = self._lattice.pieces
        return (
            [self._share(piece, rows, self._sigma[0]) for piece in down],
            [self._share(piece, cols, self._sigma[1]) for piece in right],
        )

    def light(self, lights: Floats) -> Iterator[Floats]:
        """Mean light on each of `Lattice.windows`, (R, rows, cols), out of the projector's fields
        (R, fields, N)."""
        rows, cols = self._lattice.grid
        halves = self._halves
        count = len(lights)
        # (R, halves down, halves right, rows, cols) -> (R, halves right, cols, halves down * rows)
        whole = lights.reshape(count, halves, halves, rows, cols)
        whole = whole.transpose(0, 2, 4, 1, 3).reshape(count, halves, cols, halves * rows)
        for down in self.shares[0]:
            part = (whole @ down).reshape(count, halves * cols, rows).transpose(0, 2, 1)
            for right in self.shares[1]:
                yield part @ right

    @property
    def _halves(self) -> int:
        return 2 if self._lattice.fields > 1 else 1

    def _share(self, piece: Piece, cells: int, sigma: float) -> Floats:
        halves = self._halves
        to = np.arange(cells)
        lit = (np.arange(halves)[:, None] / halves + to).ravel()  # lower edges, half by half
        low, high = to + piece.low, to + piece.high

        def both(t: Floats) -> Floats:
            if sigma == 0.0:
                return np.maximum(t, 0.0)
            density = np.exp(-0.5 * (t / sigma) ** 2) / np.sqrt(2.0 * np.pi)
            return np.asarray(t * scipy.special.ndtr(t / sigma) + sigma * density)

        first, last = lit[:, None], lit[:, None] + 1.0 / halves
        found = both(high - first) - both(low - first) - both(high - last) + both(low - last)
        near = (high > first - REACH * sigma) & (low < last + REACH * sigma)
        return np.asarray(np.where(near, found, 0.0) / (piece.high - piece.low))
