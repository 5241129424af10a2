"""Random blocks of a panel: by how many whole periods numbered stripes are off.

Stripes look the same a period further on; a picture of black and white blocks, half a period wide,
does not. At the pixels that quads are believed to see, it is as bright as predicted, or it is so a
few periods away. Blocks are as fine as the stripes, so light that comes round corners is grey in
both.
"""

from __future__ import annotations

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.geometry.phase import DecodedQuads, PhaseCode, make_panel_sequence
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import Bits, PanelSequence
from pdcd.errors import CalibrationError
from pdcd.panels.blocks import hash_to_bits

_MOST_PERIODS = 4
"""Whole periods to either side that are searched."""
_LEAST_AGREEMENT, _SECOND = 0.4, 0.6
"""Least agreement at which the number is sure, and the largest of the second best, over the
best."""
_MOST_QUADS = 200_000
"""Quads that are used, at most."""


def draw_phase_code(code: PhaseCode) -> Bits:
    """(height, width) bool, blocks of half a period."""
    side = code.period_px // 2
    cols, rows = (-(-length // side) for length in code.size_px)
    bits = hash_to_bits(f"blocks of the {code.panel}", rows, cols)
    whole = np.kron(bits, np.ones((side, side), dtype=np.bool_))
    return whole[: code.size_px[1], : code.size_px[0]]


def make_block_sequence(code: PhaseCode, refreshes: int) -> PanelSequence:
    """The photo of the blocks."""
    index = np.zeros(refreshes, dtype=np.int32)
    return make_panel_sequence(
        f"blocks-{code.panel}", code.panel, draw_phase_code(code)[None], index
    )


def find_period_error(
    photo: QuadPhoto, half: Floats, seen: DecodedQuads, code: PhaseCode
) -> tuple[int, int]:
    """By how many periods, right and down, the pixels that quads really see lie from those in
    `seen`.

    Parameters
    ----------
    photo : of the blocks. half : (h, w), half of the light of each quad, in the photo's unit.
    seen : panel pixels of the quads, right but for whole periods.

    Raises CalibrationError where no number of periods agrees.
    """
    row, col = np.nonzero(seen.valid)
    some = slice(None, None, max(1, len(row) // _MOST_QUADS))
    row, col = row[some], col[some]
    light = photo.main[row, col] / half[row, col] - 1.0
    bright = np.clip(light, -1.0, 1.0)
    at = seen.panel_px[row, col]
    blocks = np.where(draw_phase_code(code), 1.0, -1.0)
    steps = range(-_MOST_PERIODS, _MOST_PERIODS + 1)
    agreement = {
        (right, down): _agreement(bright, blocks, at + code.period_px * np.array([right, down]))
        for down in steps
        for right in steps
    }
    best, second = sorted(agreement, key=lambda off: agreement[off], reverse=True)[:2]
    if agreement[best] < _LEAST_AGREEMENT or agreement[second] > _SECOND * agreement[best]:
        raise CalibrationError(
            f"the {code.panel}'s stripes cannot be matched to the maps in use: a picture of blocks "
            f"agrees with them by {agreement[best]:.0%} at most, {best} periods away",
            device=code.panel,
            hint="use patterns that need no map: --marks xor on a scene, dots on a card",
        )
    return best


def _agreement(bright: Floats, blocks: Floats, at: Floats) -> float:
    """How well light agrees with the blocks at places (n, 2); places off the panel do not agree."""
    col, row = np.floor(at).astype(np.int64).T
    inside = (col >= 0) & (col < blocks.shape[1]) & (row >= 0) & (row < blocks.shape[0])
    predicted = np.where(inside, blocks[row * inside, col * inside], 0.0)
    return float((bright * predicted).sum() / max(np.abs(bright).sum(), 1e-12))
