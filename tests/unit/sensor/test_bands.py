"""Work on a frame, band by band."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.sensor.bands import BAND_ROWS, fill_in_bands, run_in_bands


def test_a_frame_is_what_its_bands_are() -> None:
    frame = np.random.default_rng(0).random((4 * BAND_ROWS + 3, 5, 3))
    made = fill_in_bands(frame.shape, np.float32, lambda rows: 2.0 * frame[rows])
    assert made.dtype == np.float32 and made[..., 1].flags.c_contiguous
    np.testing.assert_array_equal(made, (2.0 * frame).astype(np.float32))


def test_an_error_in_a_band_is_raised() -> None:
    def work(band: slice) -> None:
        if band.start == 3 * BAND_ROWS:
            raise ValueError("this one")

    with pytest.raises(ValueError, match="this one"):
        run_in_bands(5 * BAND_ROWS, work)
