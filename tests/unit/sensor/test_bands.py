"""Work on a frame, band by band."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.sensor.bands import ROWS, banded, in_bands


@pytest.mark.parametrize("rows", [1, ROWS, ROWS + 1, 3 * ROWS, 5 * ROWS - 1])
def test_every_row_is_worked_on_once(rows: int) -> None:
    seen = np.zeros(rows, np.int64)

    def work(band: slice) -> None:
        seen[band] += 1

    in_bands(rows, work)
    assert (seen == 1).all()


def test_a_frame_is_what_its_bands_are() -> None:
    frame = np.random.default_rng(0).random((4 * ROWS + 3, 5, 3))
    made = banded(frame.shape, np.float32, lambda rows: 2.0 * frame[rows])
    assert made.dtype == np.float32 and made[..., 1].flags.c_contiguous
    np.testing.assert_array_equal(made, (2.0 * frame).astype(np.float32))


def test_an_error_in_a_band_is_raised() -> None:
    def work(band: slice) -> None:
        if band.start == 3 * ROWS:
            raise ValueError("this one")

    with pytest.raises(ValueError, match="this one"):
        in_bands(5 * ROWS, work)
