"""Video timings out of known EDIDs and modes, and pairs of them that keep step."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdcd.bench.checks import RATE_TOLERANCE
from pdcd.presenter.timings import (
    CLOCK_TOLERANCE,
    VideoTiming,
    from_server_mode,
    match_timings,
    parse_detailed_timing,
)

# CEA-861 and VESA DMT.
FULL_HD = VideoTiming(148_500, (1920, 2008, 2052, 2200), (1080, 1084, 1089, 1125))
HD = VideoTiming(74_250, (1280, 1390, 1430, 1650), (720, 725, 730, 750))
UXGA = VideoTiming(162_000, (1600, 1664, 1856, 2160), (1200, 1201, 1204, 1250))
XGA = VideoTiming(65_000, (1024, 1048, 1184, 1344), (768, 771, 777, 806), (False, False))
REDUCED = VideoTiming(130_250, (1600, 1648, 1680, 1760), (1200, 1203, 1207, 1235), (True, False))
XGA_75 = VideoTiming(78_750, (1024, 1040, 1136, 1312), (768, 769, 772, 800))


@pytest.mark.parametrize(
    ("block", "timing"),
    [
        ("023a801871382d40582c4500000000 00001e", FULL_HD),
        ("011d007251d01e206e285500000000 00001e", HD),
        ("011d8018711c1620582c2500000000 00009e", None),  # 1080i
        ("000000fc0044454c4c203137303553 0a2020", None),  # a name
        ("023a801871382d40ff2c4540000000 00001e", None),  # sync ends beyond the line
    ],
)
def test_detailed_timings_of_known_displays(block: str, timing: VideoTiming | None) -> None:
    assert parse_detailed_timing(bytes.fromhex(block)) == timing


def test_modes_of_a_server() -> None:
    mode = {
        "dot_clock": 65_000_000, "flags": 0x2 | 0x8, "width": 1024, "h_sync_start": 1048,
        "h_sync_end": 1184, "h_total": 1344, "height": 768, "v_sync_start": 771,
        "v_sync_end": 777, "v_total": 806,
    }  # fmt: skip
    assert from_server_mode(mode) == XGA
    assert from_server_mode(mode | {"flags": 0x10}) is None
    assert from_server_mode(mode | {"dot_clock": 0}) is None
    words = '"a" 65.000 1024 1048 1184 1344 768 771 777 806 -hsync -vsync'
    assert XGA.to_modeline("a") == words


@pytest.mark.parametrize(
    ("projector", "mask", "clock_khz", "mask_mode"),
    [
        ([XGA], [UXGA], 64_996, UXGA),  # 60.0038 Hz beside 60: that of the bench's own xorg.conf
        ([FULL_HD], [UXGA], 148_500, UXGA),
        ([FULL_HD], [REDUCED, UXGA], 148_500, UXGA),  # rather than moved to 59.92 Hz
        ([FULL_HD], [REDUCED], 148_311, REDUCED),
        ([XGA_75, XGA], [UXGA], 64_996, UXGA),
        ([XGA_75], [UXGA], None, None),  # 75 Hz beside 60
        ([FULL_HD, XGA], [XGA_75], None, None),  # never another size than its own
        ([], [UXGA], None, None),
    ],
)
def test_pairs_keep_step_or_there_are_none(
    projector: list[VideoTiming],
    mask: list[VideoTiming],
    clock_khz: int | None,
    mask_mode: VideoTiming | None,
) -> None:
    found = match_timings(projector, mask)
    if clock_khz is None:
        assert found is None
        return
    assert found is not None and found[1] == mask_mode
    first, second = found
    assert first.clock_khz == clock_khz
    (own,) = [t for t in projector if replace(t, clock_khz=clock_khz) == first]
    assert abs(first.clock_khz / own.clock_khz - 1.0) <= CLOCK_TOLERANCE
    assert abs(first.refresh_hz / second.refresh_hz - 1.0) <= RATE_TOLERANCE
