"""Codes -> refreshes: which pattern each panel shows at every refresh of a shot.

A code takes one to three refreshes. P is its pattern on the projector, M on the mask, 0 black; s is
by how many refreshes the mask's light lags behind the projector's (negative: it leads):

======  =====================  =================  ==========================================
name    projector / mask       no light of other  light of the code, of its refreshes
                               codes for
======  =====================  =================  ==========================================
none    ``[P] / [M]``          s = 0              1, all of it
both    ``[P 0] / [M 0]``      -1 <= s <= 1       (1 - |s|) of 2
lag     ``[P P] / [M 0]``       0 <= s <= 1       1 of 2
lead    ``[P P] / [0 M]``      -1 <= s <= 0       1 of 2
tail    ``[P P 0] / [M 0 0]``  -1 <= s <= 2       1 of 3 for 0 <= s <= 1, less beyond
full    ``[P P P] / [0 M 0]``  -1 <= s <= 1       1 of 3
wide    full and ``[P] / [0]`` -1 <= s <= 2       1 of 4
======  =====================  =================  ==========================================

"No light of other codes" is exact, for panels that switch at once and have a perfect black: the
mask of a code is then open under its own pattern or under black only, so that a photo of indirect
light keeps no direct light. Beyond these lags the next code's light gets in for the rest of s. With
slow panels the tail of a closing mask meets what comes after it: in "both" that is a black
projector first, in "lag" and "full" the code's own pattern for one refresh, in "wide" for two, in
"tail" that and a black projector, in "lead" and "none" the next code. The projector's tail meets a
black mask except in "none". A mask's leak collects over all refreshes in which the projector is
lit: 1, 1, 2, 2, 2, 3 and 4 times its share of one refresh.

In quarter-window mode every code is shown four times, under four sub-shifts, each with the mask
open in the centre of its cells only (the paper's twelve-refresh sequence, as reconstructed).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import Patterns, make_empty_patterns
from pdcd.words import ScheduleName

SLOTS: dict[ScheduleName, tuple[tuple[bool, ...], tuple[bool, ...]]] = {
    "none": ((True,), (True,)),
    "both": ((True, False), (True, False)),
    "lag": ((True, True), (True, False)),
    "lead": ((True, True), (False, True)),
    "tail": ((True, True, False), (True, False, False)),
    "full": ((True, True, True), (False, True, False)),
    "wide": ((True, True, True, True), (False, True, False, False)),
}
"""Refreshes of one code in which projector and mask show it; they are black in the others."""


def count_slot_rows(schedule: ScheduleName) -> int:
    """Refreshes of one code."""
    return len(SLOTS[schedule][0])


def build_frames(
    pairs: tuple[Patterns, Patterns] | None,
    grid: tuple[int, int],
    *,
    window: str,
    schedule: ScheduleName,
    passes: int,
    primal_black: bool = False,
    dual_black: bool = False,
    dark_s: float = 0.0,
) -> Frames:
    """Frames of one shot.

    Parameters
    ----------
    pairs : patterns of projector and mask, P of each, over ``Lattice(grid, window).shape``; None
        shows full light through a fully open mask, `passes` times.
    schedule : a name of `SLOTS`.
    passes : how often the whole sequence is shown.
    primal_black, dual_black : keep that panel black, for the shots that measure leaks.
    dark_s : time for which both panels are black after each row.
    """
    lattice = Lattice(grid, window)
    primal, dual = (make_empty_patterns(), make_empty_patterns()) if pairs is None else pairs
    for patterns in (primal, dual):
        width = -(-lattice.lattice_cells // 8) if patterns.dtype == np.uint8 else None
        if pairs is not None and patterns.shape[1] != (width or lattice.lattice_cells):
            raise ConfigError(
                f"patterns do not cover a lattice of {lattice.shape} cells",
                hint="make the codes for the lattice of this window mode",
            )
    count = 1 if pairs is None else len(primal)
    shifts = 1 if pairs is None else lattice.fields
    slot_code = np.repeat(np.arange(count * passes), shifts)
    slot_shift = np.tile(np.arange(shifts), count * passes)
    lit, is_open = (np.array(side) for side in SLOTS[schedule])
    per_slot = lit.size
    code = np.repeat(slot_code, per_slot)
    dark, guard = np.tile(~lit, slot_code.size), np.tile(~is_open, slot_code.size)
    pattern = code % count
    return Frames(
        primal_patterns=primal,
        dual_patterns=dual,
        primal_index=np.where(
            dark, BLACK, _index(pattern, uniform=pairs is None, black=primal_black)
        ).astype(np.int32),
        dual_index=np.where(
            guard, BLACK, _index(pattern, uniform=pairs is None, black=dual_black)
        ).astype(np.int32),
        shift=np.repeat(slot_shift, per_slot).astype(np.uint8),
        code=code.astype(np.int32),
        guard=guard,
        grid=grid,
        lattice=lattice.shape,
        window=window,
        dark_s=np.full(code.size, dark_s) if dark_s else None,
    )


def _index(pattern: NDArray[np.int64], *, uniform: bool, black: bool) -> NDArray[np.int32]:
    if black or uniform:
        return np.full(pattern.size, BLACK if black else WHITE, dtype=np.int32)
    return pattern.astype(np.int32)
