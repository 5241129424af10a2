"""Planes for two DMDs: drawn as words of 24 bits, and packed for their way over USB."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from drivers.dlpc900.erle import CopyAbove, encode_picture
from pdcd.codes.make import make_codes
from pdcd.driver import Frames, draw, draw_plane_words
from pdcd.panels.map import PanelView
from pdcd.panels.patterns import BIT_PLANES, pack_bits
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.panels.schedule import build_frames
from tests.bench.measure import alone, timed
from tests.bench.tables import Aim, Section, Table, seconds

GRID, COUNT, SIZE = (48, 64), 128, (1920, 1080)
PLACES = {"upright": Placing(), "turned, bent": Placing(turn_deg=2.0, scale=1.05, radial=(0.02, 0))}
LIMIT_S = 1.0
_REPORT_S = 0.001
"""A report of 64 bytes takes so long on the USB that these devices have."""
_REPORT_B = 64


def run(*, quick: bool, folder: Path) -> Section:
    """Draw and pack all codes for both panels, each place in a process of its own."""
    table = Table(
        f"{COUNT} codes of {GRID[1]}x{GRID[0]} cells for two panels of {SIZE[0]}x{SIZE[1]}",
        ("panels", "row by row", "words", "packed", "bytes a panel", "on the USB"),
        note="Row by row is `draw`, estimated from eight rows. On the USB: at a report a "
        "millisecond, both panels at once. Turned panels copy parts of lines "
        '(`copy_above = "parts"`).',
    )
    aims = []
    for name in PLACES:
        found = alone("planes:measure_place", name=name)
        size = found["packed_b"]
        table.add(
            name,
            *(seconds(found[key]) for key in ("rows_s", "words_s", "packed_s")),
            f"{size / 1e3:.0f} kB",
            seconds(size / _REPORT_B * _REPORT_S),
        )
        aims += [
            Aim(f"planes of two DMDs drawn, {name}", "s", found["words_s"], LIMIT_S),
            Aim(f"the same packed, {name}", "s", found["packed_s"], LIMIT_S),
        ]
    return Section(
        title="Planes for DMDs",
        text="What `dlpc900` does before an upload. Where pixels lie on cells is known by then.",
        tables=[table],
        aims=aims,
    )


def measure_place(name: str) -> dict[str, Any]:
    """Seconds of each step for both panels, and the bytes of one."""
    place = PLACES[name]
    codes = make_codes("hadamard", GRID, COUNT, dual="complement")
    pairs = pack_bits(codes.primal), pack_bits(codes.dual)
    frames = build_frames(pairs, GRID, window="whole", schedule="none", passes=1)
    views = [
        PanelView("projector", make_placed_map(place, SIZE, SIZE, "projector")),
        PanelView("mask", make_placed_map(place, SIZE, SIZE, "mask")),
    ]
    copy_above: CopyAbove = "lines" if name == "upright" else "parts"
    few = range(8)
    for view in views:
        draw(frames, view, 0)  # where pixels lie is worked out once
    rows_s = timed(lambda: [draw(frames, view, row) for view in views for row in few])[0]
    words_s, words = timed(lambda: [list(_words(frames, view)) for view in views])
    packed_s, packed = timed(
        lambda: [[encode_picture(one, "GBR", copy_above) for one in own] for own in words]
    )
    return {
        "rows_s": rows_s * COUNT / len(few),
        "words_s": words_s,
        "packed_s": packed_s,
        "packed_b": sum(len(one) for one in packed[0]),
    }


def _words(frames: Frames, view: PanelView) -> Any:
    for first in range(0, COUNT, BIT_PLANES):
        yield draw_plane_words(frames, view, range(first, min(first + BIT_PLANES, COUNT)))
