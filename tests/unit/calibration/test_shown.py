"""What a photo of a calibration shows becomes frames that any display can draw."""

from __future__ import annotations

import numpy as np

from pdcd.calibration.shown import PanelSequence, make_still_sequence, pack_frames
from pdcd.panels.draw import draw
from pdcd.panels.frames import BLACK, WHITE
from pdcd.panels.map import PanelView
from pdcd.panels.placing import Placing, make_placed_map

SIZES = {"projector": (7, 5), "mask": (9, 4)}
VIEWS = {
    role: PanelView(
        role,  # type: ignore[arg-type]
        make_placed_map(Placing(turn_deg=20.0, scale=1.5), size, SIZES["projector"], role),
    )
    for role, size in SIZES.items()
}


def test_each_panel_shows_its_own_pixels_wherever_it_lies() -> None:
    rng = np.random.default_rng(1)
    projector, mask = (rng.random((2, size[1], size[0])) < 0.5 for size in SIZES.values())
    index = np.array([0, 1, WHITE, BLACK], dtype=np.int32)
    frames = pack_frames(PanelSequence("all", projector, mask, index, index[::-1]))
    for role, patterns, rows in (("projector", projector, index), ("mask", mask, index[::-1])):
        for row, which in enumerate(rows):
            wanted = np.full(patterns.shape[1:], which == WHITE) if which < 0 else patterns[which]
            assert np.array_equal(draw(frames, VIEWS[role], row), 255 * wanted.astype(np.uint8))


def test_a_still_photo_has_one_pattern_or_none() -> None:
    picture = np.eye(4, 9, dtype=np.bool_)
    shown = make_still_sequence("one", 3, projector=WHITE, mask=picture)
    frames = pack_frames(shown)
    assert shown.refreshes == 3 and len(frames.primal_patterns) == 0
    assert (draw(frames, VIEWS["projector"], 2) == 255).all()
    assert np.array_equal(draw(frames, VIEWS["mask"], 1) > 0, picture)
