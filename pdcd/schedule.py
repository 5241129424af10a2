"""Codes -> refreshes: which pattern each panel shows at every refresh of a shot.

With guards, a code takes three refreshes: the projector holds it for all three and the mask opens
only in the middle one, so that a skew of up to one refresh either way finds the mask black. In
quarter-window mode every code is shown four times, under four sub-shifts, each with the mask open
in the centre of its cells only (the paper's twelve-refresh sequence, as reconstructed).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.interfaces import BLACK, WHITE, Frames
from pdcd.lattice import Lattice
from pdcd.patterns import Patterns, none

GUARDED_REFRESHES = 3
"""Refreshes of one code with a black mask before and after it."""

WHOLE_CELL_LIMIT = 0.001
"""Misregistration in cells up to which whole cells are worth more than quarter windows: they let
about that share of the direct light into an indirect photo, whose own light is often ten times
weaker."""

QUARTER_LIMIT = 0.25
"""Misregistration in cells that quarter windows tolerate without any leak."""


def choose_window(asked: str, misregistration_cells: float) -> str:
    """ "whole" or "quarter": what "auto" means on a rig with that misregistration.

    Raises ConfigError when quarter windows cannot cover the misregistration.
    """
    window = asked
    if asked == "auto":
        window = "whole" if misregistration_cells <= WHOLE_CELL_LIMIT else "quarter"
    if window == "quarter" and misregistration_cells > QUARTER_LIMIT:
        raise ConfigError(
            f"misregistration of {misregistration_cells:.2f} cells is more than quarter windows "
            f"tolerate ({QUARTER_LIMIT})",
            hint="use fewer, larger cells or align the panels",
        )
    return window


def build_frames(
    pairs: tuple[Patterns, Patterns] | None,
    grid: tuple[int, int],
    *,
    window: str,
    guards: bool,
    passes: int,
    primal_black: bool = False,
    dual_black: bool = False,
) -> Frames:
    """Frames of one shot.

    Parameters
    ----------
    pairs : patterns of projector and mask, P of each, over ``Lattice(grid, window).shape``; None
        shows full light through a fully open mask, `passes` times.
    passes : how often the whole sequence is shown.
    primal_black, dual_black : keep that panel black, for the shots that measure leaks.
    """
    lattice = Lattice(grid, window)
    primal, dual = (none(), none()) if pairs is None else pairs
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
    per_slot = GUARDED_REFRESHES if guards else 1
    code = np.repeat(slot_code, per_slot)
    guard = np.tile(np.arange(per_slot) != per_slot // 2, slot_code.size)
    pattern = code % count
    return Frames(
        primal_patterns=primal,
        dual_patterns=dual,
        primal_index=_index(pattern, uniform=pairs is None, black=primal_black),
        dual_index=np.where(
            guard, BLACK, _index(pattern, uniform=pairs is None, black=dual_black)
        ).astype(np.int32),
        shift=np.repeat(slot_shift, per_slot).astype(np.uint8),
        code=code.astype(np.int32),
        guard=guard,
        grid=grid,
        lattice=lattice.shape,
        window=window,
    )


def _index(pattern: NDArray[np.int64], *, uniform: bool, black: bool) -> NDArray[np.int32]:
    if black or uniform:
        return np.full(pattern.size, BLACK if black else WHITE, dtype=np.int32)
    return pattern.astype(np.int32)
