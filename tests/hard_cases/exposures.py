"""Exposures of instant panels, evaluated without any rounding.

The log counts whole nanoseconds. Where panels are instant and cells whole, the realised matrix is
therefore a sum of whole numbers, and with black levels that are fractions a fraction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.frames import BLACK, WHITE, FrameLog, Frames
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import Factors, collect_factors, compute_factors
from tests.frame_logs import REFRESH_NS, make_log

Whole = NDArray[np.int64]


@dataclass(frozen=True)
class Exact:
    """Exact integrals in ns: of mask times projector (N, N), of each (N,), and of time itself.

    Levels are 0 and 1 here; black levels come in with `matrix`.
    """

    both: Whole
    mask: Whole
    light: Whole
    exposure: int

    def matrix(self, primal_leak: Fraction, dual_leak: Fraction) -> list[list[Fraction]]:
        """Realised matrix in ns, ``[n][m]``, of panels with these black levels (white is 1)."""
        p, d = primal_leak, dual_leak
        return [
            [
                d * p * self.exposure
                + p * (1 - d) * int(self.mask[n])
                + d * (1 - p) * int(self.light[m])
                + (1 - d) * (1 - p) * int(self.both[n, m])
                for m in range(self.light.size)
            ]
            for n in range(self.mask.size)
        ]

    def open_time(self, dual_leak: Fraction) -> list[Fraction]:
        """Open time of the mask in ns, cell by cell: what ambient light gets."""
        return [dual_leak * self.exposure + (1 - dual_leak) * int(m) for m in self.mask]


def log_of(
    frames: Frames,
    *,
    start_ns: int = 10_000_000,
    refresh_ns: int = REFRESH_NS,
    jitter_ns: int = 0,
    phase_ns: int = 0,
) -> FrameLog:
    """The log of panels that showed all frames, the mask `phase_ns` after the projector."""
    return make_log(
        len(frames), start_ns=start_ns, refresh_ns=refresh_ns, late_ns=phase_ns, jitter_ns=jitter_ns
    )


def closing_ns(log: FrameLog) -> int:
    """A moment after both panels went black."""
    return int(log.end_ns.max()) + 30_000_000


def realised(frames: Frames, log: FrameLog, primal: PanelOptics, dual: PanelOptics) -> Factors:
    """The program's own realised matrix of an exposure from 0 to `closing_ns`."""
    return collect_factors(
        compute_factors(frames, log, primal, dual, open_ns=0, close_ns=closing_ns(log))
    )


def spans(frames: Frames, log: FrameLog) -> tuple[Whole, Whole, Whole]:
    """Stretches of an exposure from 0 to `closing_ns` on which nothing changes.

    Returns their lengths in ns (S,), and what mask and projector show then, (S, N) of 0 and 1.
    """
    lit_at, lit = _shown(frames, log.primal_shown, log.primal_ns, int(log.end_ns[0]), primal=True)
    open_at, opened = _shown(frames, log.dual_shown, log.dual_ns, int(log.end_ns[1]), primal=False)
    edges = np.unique(np.concatenate([lit_at, open_at, [0, closing_ns(log)]]))
    i = lit[np.searchsorted(lit_at, edges[:-1], side="right") - 1]
    m = opened[np.searchsorted(open_at, edges[:-1], side="right") - 1]
    return np.diff(edges), m, i


def exact(frames: Frames, log: FrameLog) -> Exact:
    """Integrals of an exposure from 0 to `closing_ns`, in whole numbers."""
    span_ns, m, i = spans(frames, log)
    timed = span_ns[:, None] * m
    return Exact(timed.T @ i, timed.sum(axis=0), span_ns @ i, closing_ns(log))


def photo(matrix: Sequence[Sequence[Fraction]], transport: NDArray[np.float64]) -> list[Fraction]:
    """``(Pi o T) 1`` in scene units times ns, without rounding."""
    rows = zip(matrix, transport.tolist(), strict=True)
    return [sum((p * Fraction(t) for p, t in zip(*row, strict=True)), Fraction()) for row in rows]


def _shown(
    frames: Frames, shown: NDArray[np.int32], start_ns: Whole, end_ns: int, *, primal: bool
) -> tuple[Whole, Whole]:
    """Start of each content and the content, (S,) and (S, N) of 0 and 1; black first and last."""
    cells = frames.grid[0] * frames.grid[1]
    patterns = frames.primal_patterns if primal else frames.dual_patterns
    index = (frames.primal_index if primal else frames.dual_index)[shown]
    bits = np.zeros((shown.size, cells), dtype=np.int64)
    bits[index == WHITE] = 1
    coded = index > BLACK
    if coded.any():
        unpacked = np.unpackbits(patterns.astype(np.uint8), axis=1, count=cells)
        bits[coded] = unpacked[index[coded]]
    black = np.zeros((1, cells), dtype=np.int64)
    return np.concatenate([[0], start_ns, [end_ns]]), np.concatenate([black, bits, black])
