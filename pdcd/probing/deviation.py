"""How far a realised probing matrix is from the wanted one, and by what it must be divided."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.probing.realised import Factors
from pdcd.probing.wanted import Wanted

Floats = NDArray[np.float64]

BLOCK = 512
"""Rows of the matrix looked at together; bounds the memory of the report."""


class Deviation(msgspec.Struct, frozen=True, kw_only=True):
    """Realised against wanted, all relative to the weight 1 of the wanted matrix.

    `weight_s` is the best common factor (least squares), in seconds of open mask and lit
    projector. `diagonal_*` speak of direct light, point by point; `off_*` of all other paths
    between cell averages.
    """

    weight_s: float
    diagonal_max: float
    diagonal_mean: float
    off_max: float
    off_rms: float


def row_weights_s(realised: Factors, wanted: Wanted) -> tuple[Floats, Floats]:
    """Inner products of wanted and realised, and of wanted with itself, row by row, (N,) each.

    The diagonal of the realised matrix is `coaxial`: what direct light sees. Goals that treat all
    pairs alike need no matrix at all; others are looked at block by block.
    """
    cells = wanted.cells
    if wanted.uniform is not None:
        diagonal, off = wanted.uniform
        sums = np.sum(realised.left * realised.right.sum(axis=1)[:, None], axis=0)
        inside = np.sum(realised.left * realised.right, axis=0)
        inner = diagonal * realised.coaxial + off * (sums - inside)
        return inner, np.full(cells, diagonal**2 + (cells - 1) * off**2)
    inner, norm = np.empty(cells), np.empty(cells)
    for start, stop, got, want in _blocks(realised, wanted):
        inner[start:stop] = np.sum(got * want, axis=1)
        norm[start:stop] = np.sum(want * want, axis=1)
    return inner, norm


def weight_s(realised: Factors, wanted: Wanted) -> float:
    """Least-squares factor between a realised and a wanted matrix, in seconds.

    Direct light in one photo with indirect is one entry of a row against N - 1, so that factor
    follows the indirect light alone. Where codes are even, they show that slightly less, or more,
    than p times as long as direct light; with `by_direct` this is not taken out on direct light.
    Falls back to the mean open time where the wanted matrix is zero everywhere (one single cell
    has no indirect light).
    """
    if wanted.by_direct and wanted.uniform is not None:
        return float(realised.coaxial.mean()) / wanted.uniform[0]
    inner, norm = row_weights_s(realised, wanted)
    total = float(norm.sum())
    return float(inner.sum()) / total if total > 0.0 else float(realised.open_s.mean())


def deviation(
    realised: Factors, wanted: Wanted, alive: Callable[[], None] = lambda: None
) -> Deviation:
    """Compare every entry, block by block; O(R N^2) time, O(N) memory.

    `alive` is called at every block, and may raise to end the work.
    """
    weight = weight_s(realised, wanted)
    scale = weight if weight != 0.0 else 1.0
    diagonal = np.empty(wanted.cells)
    worst, square = 0.0, 0.0
    for start, stop, got, want in _blocks(realised, wanted):
        alive()
        error = got / scale - want
        rows, columns = np.arange(stop - start), np.arange(start, stop)
        diagonal[start:stop] = error[rows, columns]
        error[rows, columns] = 0.0
        worst = max(worst, float(error.max()), -float(error.min()))
        square += float(np.einsum("ij,ij->", error, error))
    pairs = max(wanted.cells * (wanted.cells - 1), 1)
    return Deviation(
        weight_s=weight,
        diagonal_max=float(np.abs(diagonal).max()),
        diagonal_mean=float(diagonal.mean()),
        off_max=worst,
        off_rms=float(np.sqrt(square / pairs)),
    )


def row_deviations(
    realised: Factors,
    wanted: Wanted,
    weight: float,
    alive: Callable[[], None] = lambda: None,
) -> tuple[Floats, Floats, Floats]:
    """Realised / weight - wanted, row by row: mean and variance off the diagonal, and the diagonal.

    (N,) float64 each; a scene of one cell has no entries off the diagonal, so 0. O(R N^2)
    time; `alive` as of `deviation`.
    """
    mean, variance, diagonal = (np.zeros(wanted.cells) for _ in range(3))
    others = max(wanted.cells - 1, 1)
    for start, stop, got, want in _blocks(realised, wanted):
        alive()
        error = got / weight - want
        rows, columns = np.arange(stop - start), np.arange(start, stop)
        diagonal[start:stop] = error[rows, columns]
        error[rows, columns] = 0.0
        mean[start:stop] = error.sum(axis=1) / others
        square = np.einsum("ij,ij->i", error, error) / others
        variance[start:stop] = np.maximum(square - mean[start:stop] ** 2, 0.0)
    return mean, variance, diagonal


def _blocks(realised: Factors, wanted: Wanted) -> Iterator[tuple[int, int, Floats, Floats]]:
    """(start, stop, realised rows, wanted rows), the realised diagonal being `coaxial`."""
    for start in range(0, wanted.cells, BLOCK):
        stop = min(start + BLOCK, wanted.cells)
        got = realised.left[:, start:stop].T @ realised.right
        got[np.arange(stop - start), np.arange(start, stop)] = realised.coaxial[start:stop]
        yield start, stop, got, wanted.rows(start, stop)
