"""Matching pursuit for all rows of a transport matrix at once.

Each row t of T is known by K0 projections ``z_k = sum_m t_m h_km`` on random signs. A row is taken
as a few strong entries over a remainder that acts like noise. Step by step, each row gains the
entries that stand out most from its remainder, and all its entries are fitted anew.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Floats, Singles

_Cells = NDArray[np.int64]

PATH_SIGMAS = 4.2
"""Standard deviations of the remainder by which a path must stand out: by chance, one path in
75 000 does, 0.04 a row of 3072 cells."""
LIKELY = 2.7
"""The same for a path next to one that was found: mirrors and caustics throw patches of light."""
PURSUIT_STEPS = 12
"""Most rounds; patches grow by one cell a round."""
AT_ONCE = 2
"""Most entries that a row gains in a round, before all are fitted anew."""
ROW_SHARE = 4
"""Projections for each entry of a row: with fewer a fit follows the remainder."""
_RIDGE = 1e-3
"""Relative weight that keeps fits of nearly equal codes finite."""
_ROUNDING = 1e-5
"""Share of a row's projections below which single precision leaves no information."""
ROW_BLOCK = 256
"""Rows whose scores are held at once."""


def pursue_paths(signs: Floats, projections: Floats, grid: tuple[int, int], noise: Floats) -> Any:
    """Find the strong entries of each row off the diagonal.

    Parameters
    ----------
    signs : (K0, N) float64
        +1 and -1; each column sums to 0.
    projections : (K0, N) float64
        ``T h_k``; column n belongs to row n of T.
    grid : (rows, cols)
        Cells, N in all.
    noise : (N,) float64
        Standard deviation of the noise of the projections of each cell.

    Returns
    -------
    sparse CSR array (N, N) float64, entries > 0, empty diagonal
    """
    rows = _Rows(signs, projections, noise)
    beside = _beside(grid)
    for _ in range(PURSUIT_STEPS):
        if not rows.grow(*_candidates(rows, beside)):
            break
    return rows.paths()


class _Rows:
    """The entries found so far: for each of N rows a list of cells, its own cell first.

    Single precision serves the search, double precision the fits.
    """

    def __init__(self, signs: Floats, projections: Floats, noise: Floats) -> None:
        count, cells = signs.shape
        self.signs: Singles = np.ascontiguousarray(signs.T, dtype=np.float32)
        self._projections = np.ascontiguousarray(projections.T)
        floor = _ROUNDING * np.sqrt(np.mean(self._projections**2, axis=1))
        self._noise = np.maximum(noise, floor)
        most = count // ROW_SHARE + 1
        self._cell = np.full((cells, most), -1)
        self._cell[:, 0] = np.arange(cells)
        self._value = np.zeros((cells, most))
        self._used = np.ones(cells, dtype=np.int64)
        self._rest = self._projections.copy()
        self._fit(np.arange(cells))

    def outstanding(self) -> Singles:
        """Remainders (N, K0), so scaled that scores ``@ signs.T`` have standard deviation 1."""
        count = self._rest.shape[1]
        free = np.maximum(count - self._used, 1)
        rms = np.maximum(np.sqrt(np.sum(self._rest**2, axis=1) / free), self._noise)
        scale = np.sqrt(count) * np.where(rms > 0.0, rms, np.inf)
        scaled: Singles = (self._rest / scale[:, None]).astype(np.float32)
        return scaled

    def known(self) -> tuple[_Cells, _Cells]:
        """Row and cell of every entry, the diagonal included."""
        row, place = np.nonzero(self._cell >= 0)
        return row, self._cell[row, place]

    def grow(self, row: _Cells, cell: _Cells, score: Singles) -> bool:
        """Add the best few candidates of each row and fit again; False when there are none."""
        best = np.lexsort((-score, row))
        row, cell = row[best], cell[best]
        rank = np.arange(row.size) - np.searchsorted(row, row)
        keep = (rank < AT_ONCE) & (self._used[row] + rank < self._cell.shape[1])
        row, cell, rank = row[keep], cell[keep], rank[keep]
        self._cell[row, self._used[row] + rank] = cell
        self._used += np.bincount(row, minlength=self._used.size)
        self._fit(np.unique(row))
        return row.size > 0

    def _fit(self, rows: _Cells) -> None:
        """Fit all entries of the given rows by least squares, rows of one length together."""
        for used in np.unique(self._used[rows]):
            some = rows[self._used[rows] == used]
            basis = self.signs[self._cell[some, :used]].astype(np.float64)
            seen = self._projections[some]
            gram = basis @ basis.transpose(0, 2, 1)
            gram += _RIDGE * seen.shape[1] * np.eye(used)
            value = np.linalg.solve(gram, basis @ seen[:, :, None])
            self._value[some, :used] = value[:, :, 0]
            self._rest[some] = seen - (value.transpose(0, 2, 1) @ basis)[:, 0]

    def paths(self) -> Any:
        """Entries off the diagonal that came out positive, CSR (N, N)."""
        row, place = np.nonzero(self._value[:, 1:] > 0.0)
        table = (self._value[row, place + 1], (row, self._cell[row, place + 1]))
        return scipy.sparse.csr_array(table, shape=(self._used.size, self._used.size))


def _candidates(rows: _Rows, beside: Any) -> tuple[_Cells, _Cells, Singles]:
    """Row, cell and score of all entries that stand out: (n,) each."""
    outstanding, cells = rows.outstanding(), rows.signs.shape[0]
    row, cell = rows.known()
    known = scipy.sparse.csr_array((np.ones(row.size, np.float32), (row, cell)), (cells, cells))
    off = row != cell
    far = scipy.sparse.csr_array((np.ones(off.sum()), (row[off], cell[off])), (cells, cells))
    patch = scipy.sparse.csr_array(beside @ far @ beside)
    found: list[tuple[_Cells, _Cells, Singles]] = []
    for start in range(0, cells, ROW_BLOCK):
        score = outstanding[start : start + ROW_BLOCK] @ rows.signs.T
        score[patch[start : start + ROW_BLOCK].nonzero()] *= PATH_SIGMAS / LIKELY
        score[known[start : start + ROW_BLOCK].nonzero()] = 0.0
        at = np.nonzero(score > PATH_SIGMAS)
        found.append((at[0] + start, at[1], score[at]))
    return (
        np.concatenate([part[0] for part in found]),
        np.concatenate([part[1] for part in found]),
        np.concatenate([part[2] for part in found]),
    )


def _beside(grid: tuple[int, int]) -> Any:
    """Which cells are a cell itself or one of its up to 8 neighbours: CSR (N, N) of ones."""
    down, across = (
        scipy.sparse.diags_array(
            [np.ones(size - 1), np.ones(size), np.ones(size - 1)], offsets=[-1, 0, 1]
        )
        for size in grid
    )
    return scipy.sparse.csr_array(scipy.sparse.kron(down, across))
