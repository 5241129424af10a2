"""Levels of patterns: packed, sent, rounded, and the light that they give."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.curve import (
    make_power_curve,
    prepare_codes,
)
from pdcd.panels.frames import BLACK, WHITE, invert_mask_patterns
from pdcd.panels.patterns import (
    pack_bits,
    pack_levels,
    read_pattern_bytes,
    read_pattern_levels,
    to_grey_bytes,
)
from pdcd.panels.schedule import build_frames

BITS = np.array([[True, False, True], [False, False, True]])
GREY = np.array([[0.0, 0.25, 1.0], [0.5, 1.0, 0.1]])


def test_levels_are_packed_where_bits_do() -> None:
    np.testing.assert_array_equal(pack_bits(BITS), [[0b10100000], [0b00100000]])
    for bits in (BITS, BITS.astype(np.float64)):
        np.testing.assert_array_equal(pack_levels(bits), pack_bits(BITS))
    assert pack_levels(GREY).dtype == np.float32
    np.testing.assert_array_equal(pack_levels(GREY), GREY.astype(np.float32))
    np.testing.assert_array_equal(pack_levels(np.array([[0.0, 2.0]])), [[0.0, 2.0]])


def test_patterns_are_read_back_as_levels_and_as_bytes() -> None:
    for cells in (3, 2):
        np.testing.assert_array_equal(
            read_pattern_levels(pack_bits(BITS), 0, cells), [1.0, 0.0, 1.0][:cells]
        )
        np.testing.assert_array_equal(
            read_pattern_bytes(pack_bits(BITS), 1, cells), [0, 0, 255][:cells]
        )
    grey = pack_levels(GREY)
    np.testing.assert_array_equal(read_pattern_levels(grey, 1, 3), grey[1].astype(np.float64))
    assert (
        read_pattern_levels(grey, 1, 3).dtype
        == read_pattern_levels(pack_bits(BITS), 1, 3).dtype
        == np.float64
    )
    np.testing.assert_array_equal(
        read_pattern_bytes(grey, 0, 3), [0, 64, 255]
    )  # 63.75 is nearest to 64
    assert to_grey_bytes(grey).tolist() == [[0, 64, 255], [128, 255, 26]]
    assert to_grey_bytes(grey).dtype == read_pattern_bytes(pack_bits(BITS), 0, 3).dtype == np.uint8


@pytest.mark.parametrize("grey", [False, True])
def test_the_second_bucket_sees_what_the_mask_keeps_out(grey: bool) -> None:
    patterns = pack_levels(GREY) if grey else pack_bits(BITS)
    frames = build_frames((patterns, patterns), (1, 3), window="whole", schedule="full", passes=1)
    other = invert_mask_patterns(frames)
    both = [
        read_pattern_levels(frames.dual_patterns, k, 3)
        + read_pattern_levels(other.dual_patterns, k, 3)
        for k in (0, 1)
    ]
    np.testing.assert_allclose(both, 1.0, atol=1e-7)
    assert other.dual_patterns.dtype == patterns.dtype
    np.testing.assert_array_equal(other.primal_patterns, frames.primal_patterns)
    assert other.dual_index.tolist() == frames.dual_index.tolist()
    assert other.primal_index.tolist() == frames.primal_index.tolist()


def test_an_open_mask_leaves_nothing_to_the_second_bucket() -> None:
    frames = build_frames(None, (1, 3), window="whole", schedule="lag", passes=2)
    other = invert_mask_patterns(frames)
    assert other.dual_index.tolist() == [BLACK] * 4 and other.dual_index.dtype == np.int32
    assert other.primal_index.tolist() == [WHITE] * 4


def test_what_is_sent_gives_its_light_rounded_to_levels() -> None:
    curve = make_power_curve(2.0)
    sent = np.array([0.0, 0.5 / 255.0 - 1e-9, 0.5 / 255.0 + 1e-9, 100.4 / 255.0, 1.0])
    np.testing.assert_allclose(
        curve.given(sent), [0.0, 0.0, (1 / 255) ** 2, (100 / 255) ** 2, 1.0], rtol=1e-12
    )
    np.testing.assert_allclose(curve.of(np.array([0, 51, 255], np.uint8)), [0.0, 0.04, 1.0])
    assert curve.sent(np.array([0.0, 0.04, 1.0])) == pytest.approx([0.0, 0.2, 1.0])


def test_black_and_white_stay_what_they_are_whatever_is_owed() -> None:
    """Dark levels of this curve are so far apart that what one of them rounds off would make grey
    of a white that follows, or of a black."""
    curve, dark = make_power_curve(0.6), 0.5 * (1 / 255) ** 0.6
    for level, owed in ((dark + 1e-4, "less"), (dark - 1e-4, "more")):
        light = np.array([[level], [1.0], [0.0], [level]])
        sent, _ = prepare_codes(light, np.ones(light.shape, np.bool_), (curve, None))
        first, white, black, again = to_grey_bytes(sent).ravel().tolist()
        assert (white, black) == (255, 0)
        # The next grey level makes up for the first one.
        assert (first, again) == ((1, 0) if owed == "less" else (0, 1))
