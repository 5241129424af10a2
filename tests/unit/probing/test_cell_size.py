"""Leak of small cells: against light summed up point by point, and published figures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from pdcd.errors import CalibrationError
from pdcd.probing.cell_size import (
    MaskAlignment,
    compute_bench_leak,
    compute_leak,
    find_cell_below_leak,
    find_largest_window,
    format_cell_leaks,
    guard_px,
    smallest_cell_px,
)

FINE = 16
"""Points along a projector pixel."""


def summed_up(cell: int, window: float, offset: tuple[float, float], blur: float) -> float:
    """The leak of one cell, on a picture: all cells around it are lit, blurred, and moved; what of
    it falls into the cell's window, over the light that falls there when all is lit."""
    around = max(3, int(np.ceil(6.0 * blur / cell)))
    side = (2 * around + 1) * cell * FINE
    own = np.zeros((side, side), dtype=np.float32)
    low = around * cell * FINE
    own[low : low + cell * FINE, low : low + cell * FINE] = 1.0
    own = ndimage.gaussian_filter(own, blur * FINE, mode="nearest", truncate=5.0)
    moved = [round(each * FINE) for each in offset]
    own = np.roll(own, moved[::-1], axis=(0, 1))
    guard = round(cell * (1.0 - window) / 2.0 * FINE)
    inner = slice(low + guard, low + cell * FINE - guard)
    return float(1.0 - own[inner, inner].mean())


@pytest.mark.parametrize(
    ("cell", "window", "offset", "blur"),
    [
        (4, 1.0, (0.25, 0.0), 0.5), (4, 0.5, (0.25, -0.5), 0.75), (2, 0.5, (0.5, 0.25), 0.75),
        (3, 0.5, (-0.25, 0.25), 1.0),
    ],
)  # fmt: skip
def test_leak_is_what_light_summed_up_gives(
    cell: int, window: float, offset: tuple[float, float], blur: float
) -> None:
    wanted = summed_up(cell, window, offset, blur)
    assert float(compute_leak(cell, window, offset, blur)) == pytest.approx(wanted, abs=4e-4)


def test_a_sharp_bench_leaks_what_is_out_of_place() -> None:
    assert float(compute_leak(4.0, 1.0, (0.5, 0.0), 0.0)) == pytest.approx(0.125)
    assert float(compute_leak(4.0, 0.5, (0.5, 0.5), 0.0)) == 0.0
    assert float(compute_leak(4.0, 0.5, (1.5, 0.0), 0.0)) == pytest.approx(0.25)


def test_the_smallest_cell_keeps_the_guard() -> None:
    bench = MaskAlignment(e95_px=0.06, blur_px=0.5)
    smallest = smallest_cell_px(bench)
    assert guard_px(smallest, 0.5) == pytest.approx(0.06 + 2.5 * 0.5)
    assert find_largest_window(bench, smallest) == pytest.approx(0.5)
    assert find_largest_window(bench, 2.0 * smallest) == pytest.approx(0.75)
    assert find_largest_window(bench, 1.0) == 0.0
    assert float(compute_bench_leak(bench, smallest, 0.5)) < 0.005


def test_the_smallest_cell_for_a_leak_is_the_smallest() -> None:
    bench = MaskAlignment(e95_px=0.3, blur_px=0.7)
    cell = find_cell_below_leak(bench, 0.005)
    assert (
        float(compute_bench_leak(bench, cell, 0.5))
        <= 0.005
        < float(compute_bench_leak(bench, cell - 0.02, 0.5))
    )
    assert find_cell_below_leak(MaskAlignment(e95_px=40.0, blur_px=40.0), 0.005) == np.inf
    assert find_cell_below_leak(MaskAlignment(0.0, 0.0), 0.0) > 0.0


def test_the_table_says_which_cells_are_too_small() -> None:
    lines = format_cell_leaks(MaskAlignment(0.06, 0.5))
    assert "guard of 1.31 px" in lines[0]
    marks = {line.split()[0]: "too small" in line for line in lines[2:-1]}
    assert marks == {"2": True, "3": True, "4": True, "6": False, "8": False, "12": False,
                     "16": False}  # fmt: skip
    assert "5.24 px" in lines[-1]


@pytest.mark.parametrize("wrong", [(-0.1, 0.3), (0.1, float("nan")), (float("inf"), 0.3)])
def test_figures_that_cannot_be_are_refused(wrong: tuple[float, float]) -> None:
    with pytest.raises(CalibrationError, match="no cell size"):
        MaskAlignment(*wrong)
