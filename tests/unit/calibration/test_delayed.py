"""Photos with a panel's rows moved, and their logs told as if a display had moved them."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.calibration.shown import PanelSequence
from pdcd.calibration.timing.delayed import shift_mask, undo_mask_shift
from pdcd.calibration.timing.timing_model import PhotoLog
from tests.frame_logs import REFRESH_NS, make_log


@pytest.mark.parametrize("rows", [-3, 0, 2])
def test_the_log_tells_what_was_planned(rows: int) -> None:
    index = np.array([0, 1, 0, 1, 1], dtype=np.int32)
    picture = np.zeros((2, 2, 3), np.bool_)
    planned = PanelSequence("one", picture, picture, index, index)
    moved = shift_mask(planned, rows, trail=4)
    assert moved.refreshes == 5 + abs(rows) + 4
    ran = undo_mask_shift(
        PhotoLog(make_log(moved.refreshes, start_ns=0, late_ns=1_000_000), 0, 10**9),
        rows,
        planned.refreshes,
    )
    for shown, asked in (
        (ran.log.primal_shown, moved.projector_index),
        (ran.log.dual_shown, moved.mask_index),
    ):
        assert np.count_nonzero(shown >= 0) == 5
        np.testing.assert_array_equal(asked, np.append(index, -1)[shown])
    assert ran.apart_s == pytest.approx(0.001 + rows * REFRESH_NS * 1e-9)
