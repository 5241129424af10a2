"""Pictures of both panels out of grabs of the screen, each distinct one kept once."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.pixels import BLACK_PICTURE, WHITE_SUM, Recorder, crop_panel


def test_panels_are_cut_out_of_the_screen() -> None:
    screen = np.zeros((6, 12, 3), dtype=np.uint8)
    screen[1:4, 2:6] = (10, 20, 30)
    screen[0:5, 6:12] = 255
    recorder = Recorder((4, 3), (6, 5))
    recorder.add(crop_panel(screen, (2, 1, 4, 3)), crop_panel(screen, (6, 0, 6, 5)))
    shown = recorder.shown()
    assert shown.projector.size_px == (4, 3)
    np.testing.assert_array_equal(shown.projector.pictures[0], np.full((3, 4), 60))
    np.testing.assert_array_equal(shown.mask.pictures[0], np.full((5, 6), WHITE_SUM))
    np.testing.assert_array_equal(shown.projector.levels(0), np.full((3, 4), 60 / 765))


def test_each_picture_is_kept_once_and_black_never() -> None:
    recorder = Recorder((2, 2), (2, 2))
    pictures = np.zeros((2, 2, 2), dtype=np.uint16)
    for levels in ((21, 0), (24, 0), (21, 27), (0, 27)):
        pictures[:] = np.reshape(levels, (2, 1, 1))  # the same array, used again
        recorder.add(*pictures)
    recorder.black()
    recorder.add(*pictures)
    shown = recorder.shown()
    assert len(shown) == 6
    black = BLACK_PICTURE
    assert shown.projector.index.tolist() == [0, 1, 0, black, black, black]
    assert shown.mask.index.tolist() == [black, black, 0, 0, black, 0]
    assert [int(p[0, 0]) for p in shown.projector.pictures] == [21, 24]
    assert not shown.mask.levels(BLACK_PICTURE).any()


def test_a_screen_that_has_shrunk_is_refused() -> None:
    with pytest.raises(ConfigError, match="does not hold the panel"):
        crop_panel(np.zeros((3, 7, 3), dtype=np.uint8), (4, 0, 4, 3))
