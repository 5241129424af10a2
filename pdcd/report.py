"""How far a realised probing matrix is from the wanted one."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from pdcd.goals import Goal
from pdcd.realised import Factors

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


def weight_s(realised: Factors, wanted: Goal) -> float:
    """Least-squares factor between a realised and a wanted matrix, in seconds.

    Falls back to the mean open time where the wanted matrix is zero everywhere (one single cell
    has no indirect light).
    """
    cells = realised.coaxial.size
    norm = cells * wanted.diagonal**2 + cells * (cells - 1) * wanted.off**2
    if norm == 0.0:
        return float(realised.open_s.mean())
    off = realised.total_s - realised.trace_s
    inner = wanted.diagonal * float(realised.coaxial.sum()) + wanted.off * off
    return inner / norm


def deviation(
    realised: Factors, wanted: Goal, alive: Callable[[], None] = lambda: None
) -> Deviation:
    """Compare every entry, block by block; O(R N^2) time, O(N) memory.

    `alive` is called at every block, and may raise to end the work.
    """
    weight = weight_s(realised, wanted)
    cells = realised.coaxial.size
    scale = weight if weight != 0.0 else 1.0
    diagonal = realised.coaxial / scale - wanted.diagonal
    worst, square = 0.0, 0.0
    for start in range(0, cells, BLOCK):
        alive()
        stop = min(start + BLOCK, cells)
        rows = realised.left[:, start:stop].T @ realised.right
        rows /= scale
        rows -= wanted.off
        rows[np.arange(stop - start), np.arange(start, stop)] = 0.0
        worst = max(worst, float(rows.max()), -float(rows.min()))
        square += float(np.einsum("ij,ij->", rows, rows))
    pairs = max(cells * (cells - 1), 1)
    return Deviation(
        weight_s=weight,
        diagonal_max=float(np.abs(diagonal).max()),
        diagonal_mean=float(diagonal.mean()),
        off_max=worst,
        off_rms=float(np.sqrt(square / pairs)),
    )
