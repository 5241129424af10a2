"""Outputs of a server that answers from a table: what is read of them, chosen, and refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from Xlib.ext import randr

from pdcd.errors import ConfigError, DeviceLost
from pdcd.presenter.edid import parse_edid
from pdcd.presenter.outputs import (
    Output,
    OutputPair,
    check_nominal,
    check_rates,
    describe_rotation,
    find_output,
    find_pair,
    has_overlap,
    mode_hz,
    place_pair,
)
from tests.edid_block import block

EPSON = block(serial="X4K700123", name="EPSON PJ")

LEFT = Output("HDMI-1", True, 0, 0, 256, 192, "left", 60.0)

RIGHT = Output("DP-1", True, 256, 10, 400, 300, "right", 60.0)

DARK = Output("VGA-1", True)

GONE = Output("DVI-1", False)

EVERY = (LEFT, RIGHT, DARK, GONE)


# Reading.


@pytest.mark.parametrize(
    ("rotation", "words"),
    [
        (randr.Rotate_0, ""),
        (randr.Rotate_90, "rotated by 90 degrees"),
        (randr.Rotate_180, "rotated by 180 degrees"),
        (randr.Rotate_270, "rotated by 270 degrees"),
        (randr.Reflect_X, "mirrored left to right"),
        (randr.Rotate_90 | randr.Reflect_Y, "rotated by 90 degrees and mirrored top to bottom"),
    ],
)
def test_how_a_server_turns_an_output_is_said_in_words(rotation: int, words: str) -> None:
    assert describe_rotation(rotation) == words


@pytest.mark.parametrize(
    ("totals", "rate_hz"),
    [
        ((65_000_000, 1344, 806), 60.0038),
        ((162_000_000, 2160, 1250), 60.0),
        ((74_250_000, 2200, 1125, randr.Interlace), 60.0),
        ((25_175_000, 800, 525, randr.DoubleScan), 29.9702),
        ((25_200_000, 800, 525, randr.DoubleScan | randr.Interlace), 60.0),
        ((0, 800, 525), None),
        ((25_200_000, 0, 525), None),
        ((25_200_000, 800, 0), None),
    ],
)
def test_published_timings_have_their_published_rates(
    totals: tuple[int, ...], rate_hz: float | None
) -> None:
    """VESA DMT 1.13: 1024 x 768, 1600 x 1200 and 640 x 480; CTA-861: 1920 x 1080 interlaced."""
    assert mode_hz(*totals) == (None if rate_hz is None else pytest.approx(rate_hz, abs=5e-5))


# What is said of them.


def test_an_output_says_where_it_is_and_what_hangs_on_it() -> None:
    assert str(LEFT) == "HDMI-1: 256 x 192 at +0+0, 60.0000 Hz"
    assert str(replace(RIGHT, turned="upside down", refresh_hz=None)) == (
        "DP-1: 400 x 300 at +256+10, unknown rate, upside down by the X server"
    )
    assert str(DARK) == "VGA-1: off" and str(GONE) == "DVI-1: not connected"
    panel = replace(GONE, edid=parse_edid(EPSON))
    assert str(panel) == "DVI-1 (EPSON PJ, serial X4K700123): not connected"


@pytest.mark.parametrize(
    ("first", "second", "both", "slip"),
    [
        (60.0, 60.0, 60.0, None), (60.0, 59.9, 59.9, 10.0), (50.0, 60.0, 50.0, 0.1),
        (None, 60.0, None, None), (60.0, None, None, None), (None, None, None, None),
    ],
)  # fmt: skip
def test_a_pair_runs_at_the_slower_rate_and_slips_by_the_difference(
    first: float | None, second: float | None, both: float | None, slip: float | None
) -> None:
    pair = OutputPair(replace(LEFT, refresh_hz=first), replace(RIGHT, refresh_hz=second))
    assert pair.refresh_hz == both
    assert pair.slip_s == (None if slip is None else pytest.approx(slip))


# Choosing.


def test_an_output_is_found_by_name_or_serial() -> None:
    known = (replace(LEFT, edid=parse_edid(EPSON)), RIGHT)
    for wanted in ("HDMI-1", "X4K700123", "16909060"):
        assert find_output(known, wanted, "projector") is known[0]
    with pytest.raises(ConfigError, match=r"no output is named 'EPSON PJ'"):
        find_output(known, "EPSON PJ", "projector")


def test_an_output_that_is_not_there_or_twice_is_refused_with_what_there_is() -> None:
    with pytest.raises(ConfigError) as none:
        find_output(EVERY, "HDMI-9", "mask")
    assert none.value.message == (
        "no output is named 'HDMI-9', by connector or EDID serial; connected: "
        f"{LEFT}; {RIGHT}; VGA-1: off"
    )
    assert none.value.device == "mask"
    assert none.value.hint == "set [display.options] mask to exactly one of them"
    with pytest.raises(ConfigError, match=r"^mask: 2 outputs are named 'HDMI-1'"):
        find_output((LEFT, LEFT), "HDMI-1", "mask")
    with pytest.raises(ConfigError, match="connected: none"):
        find_output((GONE,), "HDMI-1", "mask")


def test_an_output_that_shows_nothing_is_refused_and_one_without_a_cable_lost() -> None:
    with pytest.raises(DeviceLost) as lost:
        find_output(EVERY, "DVI-1", "projector")
    assert lost.value.device == "projector" and lost.value.hint is not None
    assert lost.value.message.startswith("output 'DVI-1' is not connected; connected: HDMI-1")
    assert "cable" in lost.value.hint
    with pytest.raises(ConfigError) as off:
        find_output(EVERY, "VGA-1", "projector")
    assert off.value.message == "output 'VGA-1' is connected but switched off"
    assert off.value.hint == "xrandr --output VGA-1 --auto, and mend xorg.conf"
    assert off.value.device == "projector"


WANTED: dict[str, Any] = {"projector": ("HDMI-1", (256, 192)), "mask": ("DP-1", (400, 300))}


@pytest.mark.parametrize("role", ["projector", "mask"])
def test_a_pair_has_the_sizes_that_were_asked_for(role: str) -> None:
    name, (width, height) = WANTED[role]
    for size in ((width + 1, height), (width, height - 1)):
        with pytest.raises(ConfigError) as told:
            find_pair(EVERY, **{**WANTED, role: (name, size)})
        assert told.value.device == role
        assert told.value.message == (
            f"{name} shows {width} x {height} pixels, not {size[0]} x {size[1]}"
        )
        assert f"xrandr --output {name} --mode {size[0]}x{size[1]}" in str(told.value.hint)


@pytest.mark.parametrize(("first", "second"), [(None, 60.0), (60.0, None), (60.0, 60.0)])
def test_rates_that_are_equal_or_unknown_pass(first: float | None, second: float | None) -> None:
    check_rates(first, second)


def test_rates_that_slip_too_fast_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"slip by one refresh every 0\.7 s \(give both"):
        check_rates(64.0, 65.5)


@pytest.mark.parametrize("role", ["projector", "mask"])
def test_modes_have_the_configured_rate_within_two_percent(role: str) -> None:
    wanted_hz = {"projector_hz": 60.0, "mask_hz": 60.0}
    pair = OutputPair(LEFT, RIGHT)
    for rate_hz in (None, 59.0, 61.0):
        other = replace(pair, **{role: replace(getattr(pair, role), refresh_hz=rate_hz)})
        check_nominal(other, **wanted_hz)
    exact = OutputPair(replace(LEFT, refresh_hz=51.0), RIGHT)
    check_nominal(exact, projector_hz=50.0, mask_hz=60.0)  # 2 % to the letter
    for rate_hz in (58.7, 61.3):
        other = replace(pair, **{role: replace(getattr(pair, role), refresh_hz=rate_hz)})
        output = getattr(pair, role)
        width, height = output.size
        with pytest.raises(ConfigError) as told:
            check_nominal(other, **wanted_hz)
        assert told.value.device == role
        assert told.value.message == f"{output.name} runs at {rate_hz:.4f} Hz, not 60 Hz"
        assert f"xrandr --output {output.name} --mode {width}x{height} --rate 60" in str(
            told.value.hint
        )


@pytest.mark.parametrize(
    ("x", "y", "common"),
    [(10, 0, False), (9, 0, True), (-20, 0, False), (-19, 0, True), (0, 10, False), (0, 9, True),
     (0, -30, False), (0, -29, True), (9, 9, True), (3, 3, True)],
)  # fmt: skip
def test_outputs_that_only_touch_have_no_pixel_in_common(x: int, y: int, common: bool) -> None:
    first, second = Output("a", True, 0, 0, 10, 10), Output("b", True, x, y, 20, 30)
    assert has_overlap(first, second) is has_overlap(second, first) is common


WHOLE = Output("screen", True, 2, 3, 700, 400, "all", 75.0)
SIZES: dict[str, Any] = {"projector": ("screen", (256, 192)), "mask": ("screen", (400, 300))}


@pytest.mark.parametrize(
    ("mask_px", "why"),
    [
        ((303, 103), "do not lie within"), ((302, 104), "do not lie within"),
        ((1, 103), "do not lie within"), ((302, 2), "do not lie within"),
        ((257, 3), "same part of the screen"), ((258, 3), None), ((302, 103), None),
    ],
)  # fmt: skip
def test_parts_of_one_output_are_a_pair_that_lies_within_it(
    mask_px: tuple[int, int], why: str | None
) -> None:
    places: dict[str, Any] = {"positions_px": ((2, 3), mask_px)}
    if why is None:
        found = place_pair((WHOLE,), **SIZES, **places)
        assert found.projector == replace(WHOLE, x=2, y=3, width=256, height=192)
        assert found.mask == replace(WHOLE, x=mask_px[0], y=mask_px[1], width=400, height=300)
        assert found.refresh_hz == 75.0
        return
    with pytest.raises(ConfigError, match=why) as told:
        place_pair((WHOLE,), **SIZES, **places)
    assert told.value.device == ("display" if "same" in why else "mask")
