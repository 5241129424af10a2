"""The pixels of a panel: exact fractions, maps, and the cells of the lattice."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any, Literal

import msgspec
import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.atoms import OUTSIDE, find_atoms
from pdcd.panels.draw import check_fit, draw, draw_plane_words, draw_planes
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.map import Map, PanelView
from pdcd.panels.patterns import pack_bits, pack_levels, split_planes
from pdcd.panels.placing import Placing, make_placed_map
from tests.panel_pixels import planned, random_frames, upright

SIZE = (45, 35)
MASK = upright(SIZE, mask=True)
BENT = Placing(
    flip="horizontal", turn_deg=11.0, scale=1.3, offset_px=(1.5, -2.5), radial=(0.04, -0.02)
)


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize(
    ("window", "grid"),
    [*product(["whole", "quarter"], [(5, 15), (7, 11), (1, 1), (35, 45)]),
     ("side-5/8", (7, 11)), ("side-3/4", (3, 5)), ("side-7/8", (7, 11))],
)  # fmt: skip
def test_every_pixel_by_exact_fractions(
    grid: tuple[int, int], window: str, grey: bool, mask: bool
) -> None:
    panel = upright(SIZE, mask=mask)
    frames = random_frames(grid, window, 8, grey=grey)
    for row in range(len(frames)):
        found = draw(frames, panel, row)
        assert found.dtype == np.uint8
        np.testing.assert_array_equal(found, planned(frames, row, panel))


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("window", ["whole", "quarter", "side-5/8"])
def test_every_pixel_under_a_map_that_bends(window: str, grey: bool, mask: bool) -> None:
    """Mirrored, turned, distorted, larger than the field; beside it even white is dark."""
    panel = PanelView("mask" if mask else "projector", make_placed_map(BENT, SIZE, SIZE, "panel"))
    frames = random_frames((7, 11), window, 8, grey=grey)
    for row in range(len(frames)):
        np.testing.assert_array_equal(draw(frames, panel, row), planned(frames, row, panel))
    white = draw(frames, panel, 4 if mask else 7)
    assert 0.2 < (white == 0).mean() < 0.5 and set(np.unique(white)) == {0, 255}


@pytest.mark.parametrize("mask", [False, True])
def test_a_row_for_none_is_black(mask: bool) -> None:
    assert not draw(random_frames((6, 8), "whole", 4), upright(SIZE, mask=mask), BLACK).any()


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("place", [Placing(), BENT], ids=["upright", "bent"])
@pytest.mark.parametrize("window", ["whole", "quarter", "side-5/8", "side-7/8"])
def test_words_hold_what_is_drawn(window: str, place: Placing, mask: bool) -> None:
    """Under all sub-shifts, with blacks, whites and guards among them, one row twice."""
    role: Literal["mask", "projector"] = "mask" if mask else "projector"
    panel = PanelView(role, make_placed_map(place, SIZE, SIZE, "panel"))
    frames = random_frames((7, 11), window, 20)
    rows = [*range(20), BLACK, 3, 19, 16]
    found = draw_plane_words(frames, panel, iter(rows))
    assert found.dtype == np.uint32 and found.shape == SIZE[::-1]
    for bit, row in enumerate(rows):
        np.testing.assert_array_equal(found >> bit & 1, draw(frames, panel, row) // 255)
    assert not (found >> 24).any()
    with pytest.raises(ConfigError, match="more than 24 rows"):
        draw_plane_words(frames, panel, [0] * 25)


def test_words_of_pixels() -> None:
    frames = frames_of_pixels()
    found = draw_plane_words(frames, SMALL_MASK, [2, 0, 1])
    for bit, row in enumerate([2, 0, 1]):
        np.testing.assert_array_equal(found >> bit & 1, draw(frames, SMALL_MASK, row) // 255)


def test_what_cannot_be_drawn_is_refused() -> None:
    frames = random_frames((6, 8), "whole", 4)
    for row in (4, -2):
        with pytest.raises(ConfigError, match=f"no row {row}"):
            draw(frames, MASK, row)
    with pytest.raises(ConfigError, match=r"8 of 6 x 8 cells have no pixel .* 5 x 9 px") as caught:
        draw(frames, upright((9, 5), mask=True), 0)
    assert caught.value.device == "mask"
    with pytest.raises(ConfigError, match="grey levels"):
        draw_planes(random_frames((6, 8), "whole", 4, grey=True), MASK, [0])


SMALL_PROJECTOR, SMALL_MASK = upright((5, 3), mask=False), upright((4, 2), mask=True)


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
    for panel in (SMALL_PROJECTOR, SMALL_MASK):
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
    check_fit(frames, SMALL_PROJECTOR)
    check_fit(frames, SMALL_MASK)
    for panel in (upright((4, 2), mask=False), upright((5, 3), mask=True)):
        with pytest.raises(ConfigError, match="not the") as caught:
            draw(frames, panel, 1)
        assert caught.value.device == panel.role


def test_bit_planes_look_at_the_patterns_of_their_own_panel() -> None:
    grey, bits = frames_of_pixels(grey=True), frames_of_pixels()
    mixed = replace(bits, dual_patterns=grey.dual_patterns)
    assert draw_planes(mixed, SMALL_PROJECTOR, [0]).shape == (3, 5, 3)
    with pytest.raises(ConfigError, match="grey levels"):
        draw_planes(mixed, SMALL_MASK, [0])
    # The first plane is the lowest bit of green.
    np.testing.assert_array_equal(
        draw_planes(bits, SMALL_MASK, [0])[..., 1], draw(bits, SMALL_MASK, 0) // 255
    )
    assert not draw_planes(bits, SMALL_MASK, []).any()
    second = split_planes(draw_plane_words(bits, SMALL_MASK, [2, 0]), "RBG")
    np.testing.assert_array_equal(draw_planes(bits, SMALL_MASK, [2, 0], order="RBG"), second)


def homography(**changes: float) -> tuple[float, ...]:
    """Of a panel of 40 x 30, with some numbers of its three rows a to i changed."""
    names = dict(zip("abcdefghi", Map.filling((40, 30)).homography, strict=True))
    return tuple({**names, **changes}.values())


@pytest.mark.parametrize(
    "changes",
    [
        {"homography": homography(b=0.1 / 40)}, {"homography": homography(d=0.1 / 30)},
        {"homography": homography(g=0.002)}, {"homography": homography(h=0.002)},
        {"radial": (0.05, 0.0)}, {"radial": (0.0, 0.05)}, {"tangential": (0.03, 0.0)},
        {"tangential": (0.0, 0.03)},
    ],
)  # fmt: skip
def test_a_single_bend_of_a_map_is_followed(changes: dict[str, Any]) -> None:
    per_cell = 16
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
