"""How a frame is cut into bands, which threads work on them, and how images lie in memory."""

from __future__ import annotations

import threading

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


def test_an_error_in_a_band_is_raised() -> None:
    def work(band: slice) -> None:
        if band.start == 3 * BAND_ROWS:
            raise ValueError("this one")

    with pytest.raises(ValueError, match="this one"):
        run_in_bands(5 * BAND_ROWS, work)


@pytest.mark.parametrize(
    ("rows", "bands"),
    [
        (1, [(0, 1)]),
        (64, [(0, 64)]),
        (65, [(0, 64), (64, 65)]),
        (200, [(0, 64), (64, 128), (128, 192), (192, 200)]),
        (0, []),
    ],
)
def test_bands_of_64_rows_and_the_rest(rows: int, bands: list[tuple[int, int]]) -> None:
    seen: list[tuple[int, int]] = []
    run_in_bands(rows, lambda band: seen.append((band.start, band.stop)))
    assert sorted(seen) == bands


@pytest.mark.parametrize("more", [0, 1])
def test_a_small_frame_is_worked_on_at_once_and_a_large_one_by_others(more: int) -> None:
    threads: set[int] = set()
    run_in_bands(512 + more, lambda _: threads.add(threading.get_ident()))
    assert (threading.get_ident() in threads) is not more
    assert len(threads) <= 2


@pytest.mark.parametrize("rows", [4, 512, 513])
def test_every_channel_is_worked_on_once(rows: int) -> None:
    seen, threads = [], set()

    def work(channel: int) -> None:
        seen.append(channel)
        threads.add(threading.get_ident())

    run_in_channels(np.empty((rows, 2, 5)), work)
    assert sorted(seen) == [0, 1, 2, 3, 4]
    assert (threading.get_ident() in threads) is (rows <= 512)


@pytest.mark.parametrize("rows", [3, 200])
def test_an_error_in_a_channel_is_raised(rows: int) -> None:
    def work(channel: int) -> None:
        if channel == 1:
            raise ValueError("this one")

    with pytest.raises(ValueError, match="this one"):
        run_in_channels(np.empty((rows, 1, 2)), work)


@pytest.mark.parametrize("more", [(), (3,), (2, 3)])
def test_channels_lie_one_after_the_other(more: tuple[int, ...]) -> None:
    image = make_planar_image((4, 5, *more))
    assert image.shape == (4, 5, *more) and image.dtype == np.float64
    for at in np.ndindex(*more):
        assert image[:, :, *at].flags.c_contiguous
    assert make_planar_image((4, 5), np.float32).dtype == np.float32
