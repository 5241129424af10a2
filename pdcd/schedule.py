"""Codes -> refreshes: which pattern each panel shows at every refresh of a shot.

With guards, a code takes three refreshes: the projector holds it for all three and the mask opens
only in the middle one, so that a skew of up to one refresh either way finds the mask black. In
quarter-window mode every code is shown four times, under four sub-shifts, each with the mask open
in the centre of its cells only (the paper's twelve-refresh sequence, as reconstructed).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pdcd.codes import Codes
from pdcd.errors import ConfigError
from pdcd.interfaces import BLACK, WHITE, Frames
from pdcd.lattice import Lattice

Side = Literal["codes", "black", "white"]

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
    codes: Codes | None,
    grid: tuple[int, int],
    *,
    window: str,
    guards: bool,
    passes: int,
    primal: Side = "codes",
    dual: Side = "codes",
) -> Frames:
    """Frames of one shot.

    Parameters
    ----------
    codes : the patterns, over ``Lattice(grid, window).shape``; None when neither side shows them,
        then `passes` counts slots.
    passes : how often the whole sequence is shown.
    primal, dual : what each panel shows in its slots; "black" for the shots that measure leaks.
    """
    lattice = Lattice(grid, window)
    if codes is not None and codes.lattice != lattice.shape:
        raise ConfigError(
            f"codes of {codes.lattice} cells do not cover a lattice of {lattice.shape}",
            hint="make the codes for the lattice of this window mode",
        )
    count = 1 if codes is None else len(codes)
    shifts = lattice.fields if codes is not None else 1
    slot_code = np.repeat(np.arange(count * passes), shifts)
    slot_shift = np.tile(np.arange(shifts), count * passes)
    per_slot = GUARDED_REFRESHES if guards else 1
    code = np.repeat(slot_code, per_slot)
    guard = np.tile(np.arange(per_slot) != per_slot // 2, slot_code.size)
    pattern = code % count
    empty = np.zeros((0, 0), dtype=np.uint8)
    return Frames(
        primal_patterns=empty if codes is None else codes.primal_bits,
        dual_patterns=empty if codes is None else codes.dual_bits,
        primal_index=_index(primal, pattern),
        dual_index=np.where(guard, BLACK, _index(dual, pattern)).astype(np.int32),
        shift=np.repeat(slot_shift, per_slot).astype(np.uint8),
        code=code.astype(np.int32),
        guard=guard,
        grid=grid,
        lattice=lattice.shape,
        window=window,
    )


def _index(side: Side, pattern: NDArray[np.int64]) -> NDArray[np.int32]:
    fixed = {"black": BLACK, "white": WHITE}
    if side in fixed:
        return np.full(pattern.size, fixed[side], dtype=np.int32)
    return pattern.astype(np.int32)
