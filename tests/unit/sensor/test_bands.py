"""Frames that are made band by band or channel by channel, and how images lie in memory."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.sensor.bands import (
    BAND_ROWS,
    fill_in_bands,
    make_planar_image,
    run_in_bands,
    run_in_channels,
)


def test_a_frame_is_what_its_bands_are() -> None:
    frame = np.random.default_rng(0).random((4 * BAND_ROWS + 3, 5, 3))
    made = fill_in_bands(frame.shape, np.float32, lambda rows: 2.0 * frame[rows])
    assert made.dtype == np.float32 and made[..., 1].flags.c_contiguous
    np.testing.assert_array_equal(made, (2.0 * frame).astype(np.float32))


@pytest.mark.parametrize("bands", [5, 20])
def test_an_error_in_a_band_is_raised(bands: int) -> None:
    def work(band: slice) -> None:
        if band.start == 3 * BAND_ROWS:
            raise ValueError("this one")

    with pytest.raises(ValueError, match="this one"):
        run_in_bands(bands * BAND_ROWS, work)


@pytest.mark.parametrize("rows", [4, 600])
def test_every_channel_is_worked_on_once(rows: int) -> None:
    seen: list[int] = []
    run_in_channels(np.empty((rows, 2, 5)), seen.append)
    assert sorted(seen) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("more", [(), (3,), (2, 3)])
def test_channels_lie_one_after_the_other(more: tuple[int, ...]) -> None:
    image = make_planar_image((4, 5, *more))
    assert image.shape == (4, 5, *more) and image.dtype == np.float64
    for at in np.ndindex(*more):
        assert image[:, :, *at].flags.c_contiguous
    assert make_planar_image((4, 5), np.float32).dtype == np.float32
