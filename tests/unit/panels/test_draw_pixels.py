"""Pictures of a panel's own pixels, and maps that bend a little."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.atoms import ATOMS_PER_CELL, OUTSIDE, find_atoms
from pdcd.panels.draw import check_fit, draw, draw_planes
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.map import Map, PanelView
from pdcd.panels.patterns import pack_bits, pack_levels
from tests.panel_pixels import upright

PROJECTOR, MASK = upright((5, 3), mask=False), upright((4, 2), mask=True)


def frames_of_pixels(*, grey: bool = False) -> Frames:
    """Row 0 shows pattern 1 of both panels, row 1 white, row 2 black."""
    rng = np.random.default_rng(1)
    levels = rng.random((2, 15)), rng.random((2, 8))
    primal, dual = (pack_levels(one) if grey else pack_bits(one < 0.5) for one in levels)
    index = np.array([1, WHITE, BLACK], dtype=np.int32)
    rows = np.zeros(3, dtype=np.int32)
    return Frames(
        primal, dual, index, index, rows.astype(np.uint8), rows, rows > 0, (1, 1), (1, 1), "pixels"
    )


@pytest.mark.parametrize("grey", [False, True])
def test_pixels_are_shown_as_they_are(grey: bool) -> None:
    frames = frames_of_pixels(grey=grey)
    assert frames.of_pixels and not replace(frames, window="whole").of_pixels
    rng = np.random.default_rng(1)
    for panel in (PROJECTOR, MASK):
        width, height = panel.size_px
        level = rng.random((2, width * height))[1].reshape(height, width)
        wanted = np.rint(255.0 * level.astype(np.float32)) if grey else 255.0 * (level < 0.5)
        found = [draw(frames, panel, row) for row in range(3)]
        np.testing.assert_array_equal(found[0], wanted)
        np.testing.assert_array_equal(found[1], np.full((height, width), 255))
        np.testing.assert_array_equal(found[2], np.zeros((height, width)))
        assert {picture.dtype for picture in found} == {np.dtype(np.uint8)}


def test_pixels_of_another_panel_are_refused() -> None:
    frames = frames_of_pixels()
    check_fit(frames, PROJECTOR)
    check_fit(frames, MASK)
    for panel in (upright((4, 2), mask=False), upright((5, 3), mask=True)):
        with pytest.raises(ConfigError, match="not the") as caught:
            draw(frames, panel, 1)
        assert caught.value.device == panel.role


def test_bit_planes_look_at_the_patterns_of_their_own_panel() -> None:
    grey, bits = frames_of_pixels(grey=True), frames_of_pixels()
    mixed = replace(bits, dual_patterns=grey.dual_patterns)
    assert draw_planes(mixed, PROJECTOR, [0]).shape == (3, 5, 3)
    with pytest.raises(ConfigError, match="grey levels"):
        draw_planes(mixed, MASK, [0])
    # The first plane is the lowest bit of green.
    np.testing.assert_array_equal(draw_planes(bits, MASK, [0])[..., 1], draw(bits, MASK, 0) // 255)
    assert draw_planes(bits, MASK, []).shape == (2, 4, 3)


def homography(**changes: float) -> tuple[float, ...]:
    """Of a panel of 40 x 30, with some numbers of its three rows a to i changed."""
    names = dict(zip("abcdefghi", Map.filling((40, 30)).homography, strict=True))
    return tuple({**names, **changes}.values())


@pytest.mark.parametrize("per_cell", [ATOMS_PER_CELL, 16])
@pytest.mark.parametrize(
    "changes",
    [
        {"homography": homography(b=0.1 / 40)},
        {"homography": homography(d=0.1 / 30)},
        {"homography": homography(g=0.002)},
        {"homography": homography(h=0.002)},
        {"radial": (0.05, 0.0)},
        {"radial": (0.0, 0.05)},
        {"tangential": (0.03, 0.0)},
        {"tangential": (0.0, 0.03)},
    ],
)
def test_a_single_bend_of_a_map_is_followed(changes: dict[str, Any], per_cell: int) -> None:
    bent = msgspec.structs.replace(Map.filling((40, 30)), **changes)
    found = find_atoms(PanelView("mask", bent), (6, 8), per_cell)
    wanted = np.floor(bent.centres() * (8 * per_cell, 6 * per_cell) + 1e-9).astype(int)
    outside = ((wanted < 0) | (wanted >= (8 * per_cell, 6 * per_cell))).any(axis=-1)
    wanted[outside] = OUTSIDE
    np.testing.assert_array_equal(found, wanted)
    even = find_atoms(PanelView("mask", Map.filling((40, 30))), (6, 8), per_cell)
    assert (found != even).any()


def test_atoms_end_where_the_field_does() -> None:
    """A panel half a field to the left and above, exactly: the other half shows nothing."""
    moved = msgspec.structs.replace(
        Map.filling((8, 4)), homography=(1 / 8, 0.0, -0.5, 0.0, 1 / 4, 0.5, 0.0, 0.0, 1.0)
    )
    found = find_atoms(PanelView("projector", moved), (1, 2))
    assert found[0, :, 0].tolist() == [OUTSIDE] * 4 + [0, 1, 2, 3]
    assert found[:, 4, 1].tolist() == [2, 3, OUTSIDE, OUTSIDE]
    assert (found[2:] == OUTSIDE).all() and (found[:, :4] == OUTSIDE).all()
