"""Each schedule, refresh by refresh, as its table has it; windows and how cells overlap."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.frames import BLACK, WHITE
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import SLOTS, build_frames, count_slot_rows
from pdcd.words import ScheduleName

B, W = BLACK, WHITE
BITS = np.array([[0b10100000], [0b01100000]], dtype=np.uint8)
"""Two patterns of 1 x 3 cells."""

TABLE: dict[ScheduleName, tuple[list[int], list[int]]] = {
    "none": ([0, 1], [0, 1]),
    "both": ([0, B, 1, B], [0, B, 1, B]),
    "lag": ([0, 0, 1, 1], [0, B, 1, B]),
    "lead": ([0, 0, 1, 1], [B, 0, B, 1]),
    "tail": ([0, 0, B, 1, 1, B], [0, B, B, 1, B, B]),
    "full": ([0, 0, 0, 1, 1, 1], [B, 0, B, B, 1, B]),
    "wide": ([0, 0, 0, 0, 1, 1, 1, 1], [B, 0, B, B, B, 1, B, B]),
}


@pytest.mark.parametrize("schedule", TABLE)
def test_two_codes_under_each_schedule(schedule: ScheduleName) -> None:
    assert SLOTS.keys() == TABLE.keys()
    frames = build_frames((BITS, BITS), (1, 3), window="whole", schedule=schedule, passes=1)
    primal, dual = TABLE[schedule]
    assert frames.primal_index.tolist() == primal and frames.dual_index.tolist() == dual
    assert frames.guard.tolist() == [index == B for index in dual]
    assert count_slot_rows(schedule) == len(primal) // 2
    assert frames.code.tolist() == [0] * (len(primal) // 2) + [1] * (len(primal) // 2)
    assert frames.shift.tolist() == [0] * len(primal)
    assert (frames.grid, frames.lattice, frames.window) == ((1, 3), (1, 3), "whole")
    assert (BLACK, WHITE) == (-1, -2)  # as tables of frames have them


def test_two_passes_under_four_shifts() -> None:
    """Codes are counted over all passes, patterns begin again; the mask's guards stay."""
    grey = np.zeros((2, 8), dtype=np.float32)
    frames = build_frames((grey, grey), (1, 3), window="quarter", schedule="both", passes=2)
    assert len(frames) == 2 * 2 * 4 * 2
    assert frames.shift.tolist() == [0, 0, 1, 1, 2, 2, 3, 3] * 4
    assert frames.code.tolist() == [code for code in range(4) for _ in range(8)]
    assert frames.primal_index.tolist() == ([0, B] * 4 + [1, B] * 4) * 2
    assert frames.lattice == (2, 4) and frames.shift.dtype == np.uint8
    assert frames.code.dtype == frames.primal_index.dtype == frames.dual_index.dtype == np.int32


@pytest.mark.parametrize(("primal_black", "dual_black"), [(True, False), (False, True)])
def test_a_panel_that_is_kept_black_leaves_the_other_as_it_is(
    primal_black: bool, dual_black: bool
) -> None:
    for pairs, shown in (((BITS, BITS), [0, B, 1, B]), (None, [W, B, W, B])):
        frames = build_frames(
            pairs, (1, 3), window="whole", schedule="both", passes=1 if pairs else 2,
            primal_black=primal_black, dual_black=dual_black,
        )  # fmt: skip
        assert frames.primal_index.tolist() == ([B] * 4 if primal_black else shown)
        assert frames.dual_index.tolist() == ([B] * 4 if dual_black else shown)
        assert frames.guard.tolist() == [False, True] * 2


@pytest.mark.parametrize(
    ("grid", "window", "fits"),
    [((1, 8), "whole", True), ((2, 4), "whole", True), ((1, 9), "whole", False),
     ((1, 7), "quarter", False), ((1, 3), "quarter", True)],
)  # fmt: skip
def test_patterns_have_one_bit_or_level_for_each_cell(
    grid: tuple[int, int], window: str, fits: bool
) -> None:
    bits, grey = np.zeros((1, 1), dtype=np.uint8), np.zeros((1, 8), dtype=np.float32)
    for pairs in ((bits, bits), (grey, grey), (bits, grey), (grey, bits)):
        if fits:
            build_frames(pairs, grid, window=window, schedule="none", passes=1)
            continue
        with pytest.raises(ConfigError, match="do not cover"):
            build_frames(pairs, grid, window=window, schedule="none", passes=1)


@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_an_open_mask_ends_at_its_border(window: str) -> None:
    """Half a cell too far down, the last row of cells is half beyond the panel's cells."""
    lattice = Lattice((3, 5), window, (0.5, 0.0))
    seen = (lattice.dual_field_uniform(1.0).ravel() @ lattice.spread).reshape(3, 5)
    inside = 1.0 if window == "whole" else 2.0  # quarter windows have a cell to spare
    open_share = seen / seen[0, 0]
    np.testing.assert_allclose(open_share[:2], 1.0)
    np.testing.assert_allclose(open_share[2], 0.5 if inside == 1.0 else 1.0)
