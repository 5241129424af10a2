"""Levels of patterns: packed, sent, rounded, and the light that they give."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.curve import (
    COPIES,
    LEVELS,
    code_to_send,
    light_of,
    power,
    sequence_to_send,
    table,
    table_fault,
)
from pdcd.panels.frames import BLACK, WHITE, second_bucket
from pdcd.panels.patterns import (
    bytes_of,
    check_binary,
    compact,
    fit,
    grey_bytes,
    levels_of,
    none,
    pack,
)
from pdcd.panels.schedule import build_frames

BITS = np.array([[True, False, True], [False, False, True]])
GREY = np.array([[0.0, 0.25, 1.0], [0.5, 1.0, 0.1]])


def test_levels_are_packed_where_bits_do() -> None:
    np.testing.assert_array_equal(pack(BITS), [[0b10100000], [0b00100000]])
    for bits in (BITS, BITS.astype(np.float64)):
        np.testing.assert_array_equal(compact(bits), pack(BITS))
    assert compact(GREY).dtype == np.float32
    np.testing.assert_array_equal(compact(GREY), GREY.astype(np.float32))
    np.testing.assert_array_equal(compact(np.array([[0.0, 2.0]])), [[0.0, 2.0]])


def test_patterns_are_read_back_as_levels_and_as_bytes() -> None:
    for cells in (3, 2):
        np.testing.assert_array_equal(levels_of(pack(BITS), 0, cells), [1.0, 0.0, 1.0][:cells])
        np.testing.assert_array_equal(bytes_of(pack(BITS), 1, cells), [0, 0, 255][:cells])
    grey = compact(GREY)
    np.testing.assert_array_equal(levels_of(grey, 1, 3), grey[1].astype(np.float64))
    assert levels_of(grey, 1, 3).dtype == levels_of(pack(BITS), 1, 3).dtype == np.float64
    np.testing.assert_array_equal(bytes_of(grey, 0, 3), [0, 64, 255])  # 63.75 is nearest to 64
    assert grey_bytes(grey).tolist() == [[0, 64, 255], [128, 255, 26]]
    assert grey_bytes(grey).dtype == bytes_of(pack(BITS), 0, 3).dtype == np.uint8


@pytest.mark.parametrize(("cells", "fits"), [(8, False), (9, True), (16, True), (17, False)])
def test_bits_fit_a_number_of_cells_in_whole_bytes(cells: int, fits: bool) -> None:
    assert fit(np.zeros((1, 2), dtype=np.uint8), cells) == fits
    assert fit(np.zeros((1, cells), dtype=np.float32), cells)
    assert not fit(np.zeros((1, cells), dtype=np.float32), cells + 1)
    assert fit(none(), cells) and none().shape == (0, 0) and none().dtype == np.uint8


def test_bit_planes_refuse_grey_levels_of_any_pattern() -> None:
    check_binary(pack(BITS), pack(BITS))
    for patterns in ((compact(GREY),), (pack(BITS), compact(GREY)), (compact(GREY), pack(BITS))):
        with pytest.raises(ConfigError, match="grey levels") as caught:
            check_binary(*patterns)
        assert caught.value.device == "display"


@pytest.mark.parametrize("grey", [False, True])
def test_the_second_bucket_sees_what_the_mask_keeps_out(grey: bool) -> None:
    patterns = compact(GREY) if grey else pack(BITS)
    frames = build_frames((patterns, patterns), (1, 3), window="whole", schedule="full", passes=1)
    other = second_bucket(frames)
    both = [
        levels_of(frames.dual_patterns, k, 3) + levels_of(other.dual_patterns, k, 3) for k in (0, 1)
    ]
    np.testing.assert_allclose(both, 1.0, atol=1e-7)
    assert other.dual_patterns.dtype == patterns.dtype
    np.testing.assert_array_equal(other.primal_patterns, frames.primal_patterns)
    assert other.dual_index.tolist() == frames.dual_index.tolist()
    assert other.primal_index.tolist() == frames.primal_index.tolist()


def test_an_open_mask_leaves_nothing_to_the_second_bucket() -> None:
    frames = build_frames(None, (1, 3), window="whole", schedule="lag", passes=2)
    other = second_bucket(frames)
    assert other.dual_index.tolist() == [BLACK] * 4 and other.dual_index.dtype == np.int32
    assert other.primal_index.tolist() == [WHITE] * 4


@pytest.mark.parametrize(("count", "told"), [(1, True), (2, False), (256, False), (257, True)])
def test_a_table_has_at_most_a_light_for_each_level(count: int, told: bool) -> None:
    assert LEVELS == 256
    assert ("needs 2 to 256" in table_fault(np.linspace(0.0, 1.0, count).tolist())) == told


def test_lights_of_a_table_may_be_whole_numbers() -> None:
    assert table_fault([0, 1]) == "" and table_fault([0, 0, 1]) == ""
    assert "falls from 0.5 to 0.25" in table_fault([0.0, 0.4, 0.5, 0.25, 0.2, 1.0])


def test_a_remembered_curve_cannot_be_spoilt() -> None:
    for curve in (power(2.0), table((0.0, 1.0))):
        assert curve.light.shape == (256,)
        with pytest.raises(ValueError, match="read-only"):
            curve.light[3] = 0.5


def test_what_is_sent_gives_its_light_rounded_to_levels() -> None:
    curve = power(2.0)
    sent = np.array([0.0, 0.5 / 255.0 - 1e-9, 0.5 / 255.0 + 1e-9, 100.4 / 255.0, 1.0])
    np.testing.assert_allclose(
        curve.given(sent), [0.0, 0.0, (1 / 255) ** 2, (100 / 255) ** 2, 1.0], rtol=1e-12
    )
    np.testing.assert_allclose(curve.of(np.array([0, 51, 255], np.uint8)), [0.0, 0.04, 1.0])
    assert curve.sent(np.array([0.0, 0.04, 1.0])) == pytest.approx([0.0, 0.2, 1.0])


def test_grey_levels_are_light_by_the_curve_of_their_panel() -> None:
    grey = compact(np.array([[0.2, 0.0, 1.0]]))
    assert light_of(grey, 0, 3, power(2.0)) == pytest.approx([0.04, 0.0, 1.0])
    assert light_of(grey, 0, 3, None) == pytest.approx([0.2, 0.0, 1.0], rel=1e-6)


@pytest.mark.parametrize(
    ("room", "copies"),
    [(0, 1), (-3, 1), (1, 1), (2, 2), (COPIES, COPIES), (COPIES + 1, COPIES)],
)
def test_a_sequence_has_as_many_copies_as_there_is_room_for(room: int, copies: int) -> None:
    """Grey levels of either panel are reason enough; both panels get as many."""
    assert COPIES == 16
    for light, mask in ((GREY, BITS), (BITS, GREY)):
        sent = sequence_to_send(light, mask, (power(2.2), power(2.2)), room)
        assert [len(patterns) for patterns in sent] == [2 * copies] * 2
        bits = sent[1] if mask is BITS else sent[0]
        np.testing.assert_array_equal(bits, np.tile(pack(BITS), (copies, 1)))


def test_a_sequence_of_bits_needs_no_copies() -> None:
    """However its bits are given, and whatever room there is."""
    for bits in (BITS, BITS.astype(np.float64), np.zeros((2, 3)), np.ones((2, 3))):
        sent = sequence_to_send(bits, BITS, (power(2.2), power(2.2)), 8)
        np.testing.assert_array_equal(sent[0], pack(bits > 0.5))
        np.testing.assert_array_equal(sent[1], pack(BITS))


def test_what_one_copy_rounds_off_the_next_makes_up_for() -> None:
    """A level of a quarter between 100 and 101: three of four copies show 100."""
    wanted = (100.0 + 0.25) / 255.0
    linear = table((0.0, 1.0))
    sent, _ = sequence_to_send(
        np.full((1, 1), wanted), np.ones((1, 1), np.bool_), (linear, linear), 8
    )
    assert sorted(grey_bytes(sent).ravel().tolist()) == [100] * 6 + [101] * 2


def test_black_and_white_stay_what_they_are_whatever_is_owed() -> None:
    """Dark levels of this curve are so far apart that what one of them rounds off would make grey
    of a white that follows, or of a black."""
    curve, dark = power(0.6), 0.5 * (1 / 255) ** 0.6
    for level, owed in ((dark + 1e-4, "less"), (dark - 1e-4, "more")):
        light = np.array([[level], [1.0], [0.0], [level]])
        sent, _ = code_to_send(light, np.ones(light.shape, np.bool_), (curve, None))
        first, white, black, again = grey_bytes(sent).ravel().tolist()
        assert (white, black) == (255, 0)
        # The next grey level makes up for the first one.
        assert (first, again) == ((1, 0) if owed == "less" else (0, 1))


def test_codes_that_the_other_panel_passes_have_an_account_of_their_own() -> None:
    """At 100.4: shown as 100 first, then 101 twice in five; the others go by themselves."""
    linear = table((0.0, 1.0))
    light = np.full((10, 1), 100.4 / 255.0)
    mask = np.arange(10)[:, None] % 2 == 0
    primal, dual = code_to_send(light, mask, (linear, linear))
    shown = grey_bytes(primal).ravel()
    for account in (shown[::2], shown[1::2]):
        assert account[0] == 100 and sorted(account.tolist()) == [100] * 3 + [101] * 2
    np.testing.assert_array_equal(dual, pack(mask))
    assert shown[::2].tolist() == shown[1::2].tolist()
