"""What a plan says of a bench that was measured, and what follows at the edges of its limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from pdcd.panels.placing import Placing
from pdcd.planning.bench_fit import (
    MOST_AUTO_CELLS,
    choose_grid_window,
    explain_bench_fit,
    explain_bit_planes,
    find_larger_window,
    find_meeting,
    resolve_window,
    with_grid,
)
from pdcd.planning.schedule_fit import (
    BY_COST,
    compute_schedule_leak,
    convert_lag_to_rows,
    scan_out_lags_s,
)
from pdcd.probing.cell_size import MaskAlignment, compute_bench_leak, find_largest_window
from pdcd.protocol.request import CaptureRequest
from tests.unit.planning.test_measured import config

TIMES = {"rise_s": 2e-4, "fall_s": 3e-4}


def test_a_meeting_is_what_was_measured_of_both_panels() -> None:
    assert find_meeting(Config()) is None
    assert find_meeting(config(rig={"misregistration_px": 0.3})) == MaskAlignment(0.3, 0.0, 0.64)
    found = find_meeting(config(mask={"blur_px": 0.5}))
    assert found is not None and (found.e95_px, found.blur_px) == (0.0, 0.5)
    assert found.mask_px == pytest.approx(1024 / 1600)


def test_the_worst_row_decides_on_a_schedule() -> None:
    still = config(projector=TIMES, mask=TIMES)
    rows = config(projector={**TIMES, "scan_s": 0.01}, mask={**TIMES, "scan_s": -0.01})
    low_s, high_s = scan_out_lags_s(rows)
    for name in BY_COST:
        worst = max(compute_schedule_leak(still, name, 0.003 + row_s) for row_s in (low_s, high_s))
        assert compute_schedule_leak(rows, name, 0.003) == pytest.approx(worst)


def test_rows_are_set_from_above_or_from_below() -> None:
    """The middle of the uppermost of nine points a side is at 1/18 of the field."""
    down = config(mask={"scan_s": 0.018})
    assert scan_out_lags_s(down) == pytest.approx((0.001, 0.017))
    up = config(mask={"scan_s": -0.018})
    assert scan_out_lags_s(up) == pytest.approx((0.001, 0.017))
    before = config(projector={"scan_s": 0.018})
    assert scan_out_lags_s(before) == pytest.approx((-0.017, -0.001))
    both = config(projector={"scan_s": 0.009}, mask={"scan_s": 0.018})
    assert scan_out_lags_s(both) == pytest.approx((0.0005, 0.0085))
    lag, jitter = convert_lag_to_rows(both, 0.001)
    assert lag == pytest.approx((0.001 + 0.0045) * 60.0)
    assert jitter == pytest.approx(0.5 * 0.008 / 4.0 * 60.0)
    unknown, same = convert_lag_to_rows(both, None)
    assert unknown is None and same == pytest.approx(jitter)


def test_a_larger_window_is_told_where_it_fits() -> None:
    """Cells of 64 pixels of either panel, whose sixteenths are whole ones."""
    even = {"size_px": (1024, 768)}
    rig = config(rig={"misregistration_px": 0.01}, mask=even)
    assert find_larger_window(config(rig={"misregistration_px": 0.01}), (12, 16)) is None
    assert find_larger_window(Config(), (12, 16)) is None
    found = find_larger_window(rig, (12, 16))
    meeting = find_meeting(rig)
    assert found is not None and meeting is not None
    side = {"side-5/8": 0.625, "side-3/4": 0.75, "side-7/8": 0.875}[found]
    assert side <= find_largest_window(meeting, 64.0)
    told = explain_bench_fit(rig, (12, 16), "quarter", "full", None)
    assert told[0] == (
        "cells of 64 projector pixels: the panels meet within 0.01 px (95 % of the field), "
        "blur is 0 px"
    )
    leak = 100.0 * float(compute_bench_leak(meeting, 64.0, 0.5))
    assert told[1].startswith(f"window quarter: {leak:.2g} % of the direct light leaks")
    assert told[2].startswith(f"window {found} has {4.0 * side**2:.3g} times the light")
    assert len(told) == 3
    assert len(explain_bench_fit(rig, (12, 16), found, "full", None)) == 2
    # The shorter side of a cell counts, whichever that is.
    wide = explain_bench_fit(rig, (12, 20), "quarter", "full", None)
    tall = explain_bench_fit(rig, (15, 16), "quarter", "full", None)
    assert wide[0].startswith("cells of 51.2 ") and tall[0].startswith("cells of 51.2 ")
    near = config(rig={"misregistration_px": 3.0}, mask=even)
    sides = {grid: find_larger_window(near, grid) for grid in ((12, 16), (12, 64), (48, 16))}
    assert sides[12, 64] == sides[48, 16] != sides[12, 16]
    rough = config(rig={"misregistration_px": 16.0}, mask=even)
    assert find_larger_window(rough, (12, 16)) is None
    assert len(explain_bench_fit(rough, (12, 16), "quarter", "full", None)) == 2


def test_the_lag_is_told_where_times_are_measured_and_there_are_guards() -> None:
    rig = config(projector=TIMES, mask=TIMES)
    (told,) = explain_bench_fit(rig, (12, 16), "whole", "lag", 0.004)
    leak = compute_schedule_leak(rig, "lag", 0.004)
    assert told == (
        "schedule lag: the mask follows by 4 to 4 ms; "
        f"{100.0 * leak:.2g} % of a code's light gets into its neighbours"
    )
    assert explain_bench_fit(rig, (12, 16), "whole", "none", 0.004) == ()
    assert explain_bench_fit(rig, (12, 16), "whole", "lag", None) == ()
    assert explain_bench_fit(config(mask=TIMES), (12, 16), "whole", "lag", 0.004) == ()
    rows = config(projector=TIMES, mask={**TIMES, "scan_s": 0.009})
    (told,) = explain_bench_fit(rows, (12, 16), "whole", "lag", 0.004)
    assert "follows by 4.5 to 12 ms" in told


def test_whole_windows_of_panels_that_were_placed_say_what_gets_through() -> None:
    """A mask that is shifted by a tenth of a cell."""
    placed = config(mask={"place": Placing(offset_px=(10.0, 0.0))})
    told = explain_bench_fit(placed, (12, 16), "whole", "full", None)
    assert len(told) == 1 and told[0].startswith("window whole: the panels draw different cells in")
    assert explain_bench_fit(placed, (12, 16), "quarter", "full", None) == ()
    assert explain_bench_fit(Config(), (12, 16), "whole", "full", None) == ()
    assert choose_grid_window("auto", Config(), (12, 16)) == "whole"
    assert choose_grid_window("whole", placed, (12, 16)) == "whole"


def test_cells_that_do_not_end_with_pixels_name_those_that_do() -> None:
    whole = explain_bench_fit(Config(), (36, 48), "whole", "full", None)
    assert whole[-1] == "cells of 36 x 48 do not end on the pixels of both panels; 48 x 64 do"
    assert "their light is subtracted" in whole[0]
    assert explain_bench_fit(Config(), (36, 48), "quarter", "full", None) == whole[-1:]
    for goal, window in (("indirect", "whole"), ("direct", "whole"), ("fraction", "quarter")):
        asked: dict[str, Any] = {"goal": goal, "p": 0.25 if goal == "fraction" else None}
        request = CaptureRequest(**asked)
        assert resolve_window(request, Config(), (36, 48)) == window
    assert (
        resolve_window(CaptureRequest(goal="indirect", white=False), Config(), (36, 48))
        == "quarter"
    )


def test_windows_that_end_within_pixels_of_the_mask_are_refused() -> None:
    """Cells of 100 x 100 pixels of the mask have whole eighths in 8 of them only."""
    with pytest.raises(ConfigError, match=r"side-5/8 windows do not lie on .* 12 x 16") as caught:
        choose_grid_window("side-5/8", Config(), (12, 16))
    assert caught.value.device == "mask" and "16 of its pixels" in str(caught.value.hint)
    assert choose_grid_window("quarter", Config(), (12, 16)) == "quarter"


def test_planes_of_a_refresh_say_how_long_they_are() -> None:
    assert explain_bit_planes(Config()) == ()
    (told,) = explain_bit_planes(config(display={"planes_per_refresh": 24}))
    assert told == "24 planes a refresh, of 0.694 ms: 1440 a second"


@pytest.mark.parametrize(("e95_px", "blur_px"), [(0.0, 0.001), (0.4, 0.0), (0.4, 0.8), (3.0, 1.0)])
def test_automatic_cells_fill_the_field_and_are_not_too_many(e95_px: float, blur_px: float) -> None:
    rig = config(
        rig={"misregistration_px": e95_px}, mask={"blur_px": blur_px}, schedule={"grid": "auto"}
    )
    found = with_grid(rig).schedule.grid
    assert isinstance(found, tuple)
    rows, columns = found
    assert rows * columns <= MOST_AUTO_CELLS
    cell_px = 768 / rows
    assert cell_px >= 4.0 * 1024 / 1600 - 1e-9  # four pixels of the mask
    assert columns == pytest.approx(rows * 1024 / 768, abs=2)
    meeting = find_meeting(rig)
    assert meeting is not None
    largest = max(768 / (rows + 1), 1024 / (columns + 1))
    limits = (4.0 * 0.64, 2.0, np.sqrt(1024 * 768 / MOST_AUTO_CELLS))
    assert float(compute_bench_leak(meeting, largest, 0.5)) > 0.004 or largest <= max(limits) * (
        1 + 1e-9
    )


def test_cells_that_no_size_can_save_are_the_usual_ones() -> None:
    rig = config(rig={"misregistration_px": 200.0}, schedule={"grid": "auto"})
    assert with_grid(rig).schedule.grid is None
