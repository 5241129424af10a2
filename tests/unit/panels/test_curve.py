"""Light of grey levels, what is sent for some light, and how levels are packed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.panels.curve import (
    COPIES,
    find_table_fault,
    make_power_curve,
    prepare_codes,
    prepare_sequence,
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


@pytest.mark.parametrize(
    ("lights", "told"),
    [
        ((0.0,), "needs 2 to 256"),
        ((0.0,) * 256 + (1.0,), "needs 2 to 256"),
        ((0.0,) * 255 + (1.0,), ""),
        ((0.1, 1.0), "begin with 0"),
        ((0.0, 0.9), "end with 1"),
        ((0.0, 0.7, 0.6, 1.0), "falls from 0.7 to 0.6"),
        ((0.0, float("nan"), 1.0), "begin with 0"),
        ((0.0, 0.0, 1.0, 1.0), ""),
    ],
)
def test_a_table_that_is_none_is_told(lights: tuple[float, ...], told: str) -> None:
    assert find_table_fault(lights).find(told) >= 0 and bool(find_table_fault(lights)) == bool(told)


def test_levels_of_codes_are_mixed_in_two_accounts() -> None:
    """By bytes as they are drawn, and a power law by hand: the sum over the codes in which a cell
    is lit, and over all others, is off by one step at most; a closed cell stays closed."""
    rng = np.random.default_rng(4)
    lit, mask = rng.random((64, 40)) < 0.5, rng.random((64, 40)) * (rng.random((64, 40)) < 0.7)
    _, sent = prepare_codes(lit, mask, (None, make_power_curve(2.2)))
    light = np.array([(read_pattern_bytes(sent, k, 40) / 255.0) ** 2.2 for k in range(64)])
    assert light[mask == 0.0].max() == 0.0
    for account in (lit, ~lit):
        assert np.abs(((light - mask) * account).sum(axis=0)).max() < 2.2 / 255.0
    plain = (np.rint(255.0 * mask ** (1 / 2.2)) / 255.0) ** 2.2
    assert np.abs(((plain - mask) * lit).sum(axis=0)).max() > 2.0 * 2.2 / 255.0


def test_an_exact_sequence_comes_in_copies_whose_mean_is_right() -> None:
    rng = np.random.default_rng(5)
    light, mask = rng.random((3, 30)), rng.random((3, 30)) < 0.5
    primal, dual = prepare_sequence(
        light, mask, (make_power_curve(2.2), make_power_curve(2.2)), 100
    )
    assert len(primal) == len(dual) == 3 * COPIES
    shown = np.array([(read_pattern_levels(primal, k, 30)) ** 2.2 for k in range(len(primal))])
    mean = shown.reshape(COPIES, 3, 30).mean(axis=0)
    assert np.abs(mean - light).max() < 1.2 * 2.2 / 255.0 / COPIES
    assert len(prepare_sequence(light, mask, (make_power_curve(2.2), None), 5)[0]) == 15
    assert len(prepare_sequence(mask, mask, (make_power_curve(2.2), None), 5)[0]) == 3


@pytest.mark.parametrize("copies", [2, 8, 16])
@pytest.mark.parametrize("gamma", [1.8, 2.2])
def test_the_last_two_copies_make_up_for_uneven_levels(copies: int, gamma: float) -> None:
    """By a power law worked out here: less is left than evenly spaced levels leave, although the
    largest step is twice as large; black, white and bits stay as they are."""
    rng = np.random.default_rng(6)
    light = np.clip(rng.random((4, 200)) * 1.2 - 0.1, 0.0, 1.0)
    bits = rng.random((4, 200)) < 0.5

    def left(panel: int, law: float) -> Any:
        first, second = (bits, light) if panel else (light, bits)
        sent = prepare_sequence(
            first, second, (make_power_curve(law), make_power_curve(law)), copies
        )[panel]
        levels = np.array([read_pattern_bytes(sent, k, 200) for k in range(len(sent))]) / 255.0
        given = (levels**law).reshape(copies, 4, 200)
        assert np.all(given[:, light == 0.0] == 0.0) and np.all(given[:, light == 1.0] == 1.0)
        return np.sqrt(np.mean((given.mean(axis=0) - light) ** 2))

    for panel in (0, 1):
        assert left(panel, gamma) < 0.65 * left(panel, 1.0)
        # Evenly spaced levels leave up to half a step, a third of it as RMS, over all copies.
        assert left(panel, 1.0) == pytest.approx(1.0 / 255.0 / 12**0.5 / copies, rel=0.2)


def test_both_panels_may_be_grey_at_once() -> None:
    """What two panels are off by is not off in the same copy: the sum of their products is right to
    what linear panels leave."""
    rng = np.random.default_rng(7)
    light, mask = rng.random((2, 150)), rng.random((2, 150))

    def left(law: float) -> Any:
        sent = prepare_sequence(light, mask, (make_power_curve(law), make_power_curve(law)), 16)
        primal, dual = (
            (np.array([read_pattern_bytes(one, k, 150) for k in range(32)]) / 255.0) ** law
            for one in sent
        )
        return np.sqrt(np.mean((dual.T @ primal / 16 - mask.T @ light) ** 2))

    assert left(2.2) < 1.2 * left(1.0)


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


@pytest.mark.parametrize(
    ("room", "copies"),
    [(0, 1), (-3, 1), (1, 1), (2, 2), (COPIES, COPIES), (COPIES + 1, COPIES)],
)
def test_a_sequence_has_as_many_copies_as_there_is_room_for(room: int, copies: int) -> None:
    """Grey levels of either panel are reason enough; both panels get as many."""
    for light, mask in ((GREY, BITS), (BITS, GREY)):
        sent = prepare_sequence(light, mask, (make_power_curve(2.2), make_power_curve(2.2)), room)
        assert [len(patterns) for patterns in sent] == [2 * copies] * 2
        bits = sent[1] if mask is BITS else sent[0]
        np.testing.assert_array_equal(bits, np.tile(pack_bits(BITS), (copies, 1)))
