"""What tests of codes count and compare: probing matrices in integers, far light cell by cell."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.codes import alike
from pdcd.codes.make import Codes

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

GRID = (12, 16)
N = GRID[0] * GRID[1]
RADIUS = 2
BEST = 1.0 / 26.0
ROW, COL = np.divmod(np.arange(N), GRID[1])
APART = np.maximum(np.abs(ROW[:, None] - ROW), np.abs(COL[:, None] - COL))
BEYOND = (APART > RADIUS).astype(float)
"""Of far light: on `GRID`, from beyond `RADIUS`, lit in the share `BEST` of codes."""


def probing(codes: Codes) -> NDArray[np.int64]:
    """sum_k m_k i_k^T by integer arithmetic: (L, L)."""
    return codes.dual.astype(np.int64).T @ codes.primal.astype(np.int64)


def around(lit: Bools) -> Bools:
    """Where the mask may be open: no lit cell within the radius."""
    seen: Bools = lit.astype(float) @ (1.0 - BEYOND) == 0.0
    return seen


def correlate_light() -> Floats:
    """The correlation that light of two cells is taken to have, (N, N)."""
    square = (ROW[:, None] - ROW) ** 2 + (COL[:, None] - COL) ** 2
    same: Any = sum(
        share * np.exp(-square / (2.0 * reach**2)) for reach, share in alike.CORRELATION_GAUSSIANS
    )
    return np.asarray(same + alike.OWN_LIGHT * np.eye(N))


def far_error(lit: Bools, mask: Bools | Floats, transport: Floats) -> float:
    """RMS error of the far photo over that of the true one, each cell over its own weight."""
    counted = mask.astype(float).T @ lit.astype(float)
    assert not (counted * (1.0 - BEYOND)).any()
    weight = (counted * BEYOND).sum(axis=1) / BEYOND.sum(axis=1)
    truth = (BEYOND * transport).sum(axis=1)
    error = (counted * transport).sum(axis=1) / weight - truth
    return float(np.sqrt(np.mean(error**2) / np.mean(truth**2)))
