"""Pictures to set a bench up by: what each must show for the eye to be able to tell."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config, PanelConfig
from pdcd.calibration.pictures import FLASH_EVERY, MOVING, POSITIONS, STILL
from pdcd.capture.show import PATTERNS, make_pattern_frames, make_pixel_frames
from pdcd.panels.draw import draw
from pdcd.panels.frames import BLACK
from pdcd.words import MovingName, PatternName

SIZES = ((64, 48), (101, 77))
SMALL = Config(projector=PanelConfig(size_px=SIZES[0]), mask=PanelConfig(size_px=SIZES[1]))


def test_words_and_pictures_are_the_same() -> None:
    assert get_args(PatternName) == ("black", *PATTERNS)
    assert get_args(MovingName) == tuple(MOVING)


@pytest.mark.parametrize("size", SIZES)
def test_levels_and_sizes(size: tuple[int, int]) -> None:
    for picture in [*(make(size) for make in STILL.values()), *MOVING["bar"](size)]:
        assert picture.shape == size[::-1]
        assert picture.min() == 0.0 and picture.max() == 1.0


def test_the_letter_tells_every_mirrored_and_turned_panel() -> None:
    picture = STILL["letter"]((60, 60))
    turns = [np.rot90(picture, k) for k in range(4)]
    ways = [*turns, *(np.fliplr(turn) for turn in turns)]
    for one in range(8):
        for other in range(one):
            assert np.mean(ways[one] != ways[other]) > 0.05


def test_what_moves_takes_one_step_a_refresh() -> None:
    size = (128, 96)
    for k, picture in enumerate(MOVING["bar"](size)):
        columns = np.flatnonzero(picture.any(axis=0))
        assert columns.min() == k * 4 and columns.size == 4
        assert bool(picture[0].any()) == (k % 8 == 0)
    lit = [picture.mean() for picture in MOVING["edge"](size)]
    np.testing.assert_allclose(lit, np.arange(1, POSITIONS + 1) / POSITIONS)
    flashes = [picture.mean() for picture in MOVING["flash"](size)]
    assert flashes == [1.0, *[0.0] * (FLASH_EVERY - 1)]


@pytest.mark.parametrize("pattern", [*STILL, "projector", "mask"])
def test_each_panel_is_drawn_at_its_own_pixels(pattern: str) -> None:
    frames = make_pattern_frames(pattern, 0, (6, 8), SMALL)
    views = panels_of(SMALL)
    for role, view, size in zip(
        ("projector", "mask"), (views.projector, views.mask), SIZES, strict=True
    ):
        found = draw(frames, view, 0)
        if pattern in STILL:
            wanted = np.rint(255.0 * STILL[pattern](size).astype(np.float32))
        else:
            wanted = np.full(size[::-1], 255.0 * (pattern == role))
        assert np.array_equal(found, wanted)


def test_what_moves_does_so_for_as_long_as_was_asked() -> None:
    assert len(make_pixel_frames("bar", SMALL)) == POSITIONS
    frames = make_pixel_frames("flash", SMALL, seconds=2.0)
    assert len(frames) == 120 and BLACK not in frames.primal_index
