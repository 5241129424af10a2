"""The field: the largest upright rectangle of the projector's picture that mask and camera share.

No mask covers a projector's picture exactly. What it leaves out gives cells without pixels, and
what the camera does not see gives cells without light; so codes fill what all three have in common,
in whole pixels of the projector (docs/calibration.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, find_pixels_on
from pdcd.panels.map_soundness import SHORT_PX

FieldBox = tuple[int, int, int, int]
"""Left, top, width and height in pixels of the projector."""

_MOST_PLACES = 1_500_000
"""Pixels that are searched one by one, at most; a larger picture is searched by blocks."""
ENOUGH = 0.5
"""Share of the projector's picture below which something is to be moved."""
_WHOLE_CELLS = 0.02
"""Share of the field that is given up so that its cells are of whole pixels."""
_ASIDE, _LARGE = 0.05, 0.9
"""Largest shift, as a share of the picture, that advice does not mention, and size over the
picture's from which it does not mention the size."""
_SIGMAS = 3.0
"""Standard deviations of a map by which the field keeps off a device's edge."""


@dataclass(frozen=True)
class SharedField:
    """The field, and what to move where it is small.

    box : of the field. share : of the projector's picture. advice : sentences; one says what was
    given up for whole cells.
    """

    box: FieldBox
    share: float
    advice: tuple[str, ...] = ()


def find_shared_field(
    size_px: tuple[int, int],
    devices: Mapping[str, Map],
    edges_px: Mapping[str, float],
    grid: tuple[int, int] | None,
) -> SharedField:
    """The field that the projector shares with its devices.

    Parameters
    ----------
    size_px : width and height of the projector.
    devices : maps of the mask and of the camera to its picture.
    edges_px : how far from each one's edge the field keeps, in its own pixels.
    grid : rows and columns of cells that are to be of whole pixels where that costs little; None:
        any cells.

    Raises CalibrationError, with the advice as its hint, where they share nothing.
    """
    picture = Map.filling(size_px)
    good = {name: find_pixels_on(picture, map_, edges_px[name]) for name, map_ in devices.items()}
    all_of = np.logical_and.reduce(list(good.values()))
    box = find_largest_box(all_of)
    share = box[2] * box[3] / (size_px[0] * size_px[1])
    told: list[str] = []
    if share < ENOUGH:
        for name, map_ in devices.items():
            if (covered := float(good[name].mean())) < _LARGE:
                told.append(_advice(name, map_, size_px, covered))
    if not box[2] * box[3]:
        raise CalibrationError(
            "projector, mask and camera have no part of the projector's picture in common",
            device="mask",
            hint="; ".join(told) or "let the camera see the projector's picture through the mask",
        )
    if grid is not None and (fitted := fit_whole_cells(box, grid)) != box:
        told.append(
            f"the field is {fitted[2]} x {fitted[3]} pixels, not {box[2]} x {box[3]}, so that "
            f"its {grid[0]} x {grid[1]} cells are made of whole pixels"
        )
        box = fitted
    return SharedField(box, share, tuple(told))


def edge_px(sigma_px: float, own_px: float) -> float:
    """How far the field keeps from a device's edge, in the device's pixels, because its map has
    errors. The outermost pixel may lie half beyond the edge, which nobody sees
    (`pdcd.panels.map_soundness.SHORT_PX`).

    sigma_px : standard deviation of the map in projector pixels. own_px : pixels of the device
        along one of the projector's.
    """
    return _SIGMAS * sigma_px * own_px - SHORT_PX


def find_largest_box(good: Bools) -> FieldBox:
    """The largest rectangle of a picture (height, width) in which all is good; an empty one where
    there is none. A large picture is searched by blocks of pixels; then the sides of the rectangle
    are moved outwards while all in it is good."""
    block = math.ceil(math.sqrt(good.size / _MOST_PLACES))
    if block <= 1:
        return _largest(good)
    high, wide = (side // block for side in good.shape)
    blocks = good[: high * block, : wide * block].reshape(high, block, wide, block)
    left, top, width, height = (
        block * side for side in _largest(np.asarray(blocks.all(axis=(1, 3))))
    )
    return _grown(good, (left, top, width, height)) if width * height else (0, 0, 0, 0)


def _largest(good: Bools) -> FieldBox:
    """The same, pixel by pixel. For each row it finds the rectangles that end there, by a stack of
    the columns whose heights grow."""
    best, found = 0, (0, 0, 0, 0)
    heights = np.zeros(good.shape[1] + 1, dtype=np.int64)  # the last one stays 0
    for row in range(good.shape[0]):
        heights[:-1] = (heights[:-1] + 1) * good[row]
        starts: list[int] = []
        tops: list[int] = []
        for column, height in enumerate(heights.tolist()):
            start = column
            while tops and tops[-1] >= height:
                start, top = starts.pop(), tops.pop()
                if top * (column - start) > best:
                    best = top * (column - start)
                    found = start, row + 1 - top, column - start, top
            if height:
                starts.append(start)
                tops.append(height)
    return found


def _grown(good: Bools, box: FieldBox) -> FieldBox:
    """A rectangle whose sides are moved outwards, one pixel at a time, while all is good."""
    left, top, width, height = box
    right, bottom = left + width, top + height
    grew = True
    while grew:
        grew = False
        if left > 0 and good[top:bottom, left - 1].all():
            left, grew = left - 1, True
        if right < good.shape[1] and good[top:bottom, right].all():
            right, grew = right + 1, True
        if top > 0 and good[top - 1, left:right].all():
            top, grew = top - 1, True
        if bottom < good.shape[0] and good[bottom, left:right].all():
            bottom, grew = bottom + 1, True
    return left, top, right - left, bottom - top


def fit_whole_cells(box: FieldBox, grid: tuple[int, int]) -> FieldBox:
    """The field made smaller about its middle so that its cells are of whole pixels, where that
    gives up no more than `_WHOLE_CELLS` of it; else the field as it is."""
    left, top, width, height = box
    rows, cols = grid
    wide, high = width // cols * cols, height // rows * rows
    if wide * high < (1.0 - _WHOLE_CELLS) * width * height:
        return box
    return left + (width - wide) // 2, top + (height - high) // 2, wide, high


def _advice(name: str, map_: Map, size_px: tuple[int, int], covered: float) -> str:
    """What to move where a device covers too little of the projector's picture."""
    size = np.array(size_px, dtype=np.float64)
    own = np.array(map_.size_px, dtype=np.float64)
    middle = map_.to_field(0.5 * own) * size
    area = abs(float(np.linalg.det(map_.jacobian(0.5 * own)))) * float(own.prod())
    how = list(_moves(0.5 * size - middle, size, math.sqrt(area)))
    if name == "mask":
        said = f"the mask covers {covered:.0%} of the projector's picture"
        what = "move the mask's image, or the projector's the other way,"
        zoom = f"make the projector's picture {math.sqrt(area):.2f} times as large, or the mask's"
        zoom += f" image {1.0 / math.sqrt(area):.2f} times"
    else:
        said = f"the camera sees {covered:.0%} of the projector's picture"
        what = "turn the camera so that its view moves"
        zoom = f"move the camera back or zoom it out, so that it sees {1.0 / math.sqrt(area):.2f} "
        zoom += "times as far"
    todo = [f"{what} {' and '.join(how)} (projector pixels)"] if how else []
    todo += [zoom] if area < _LARGE**2 else []
    return f"{said}: {'; '.join(todo) or 'let it stand upright'}"


def _moves(by_px: Floats, size: Floats, scale: float) -> Iterator[str]:
    """Ways to move a device by so many projector pixels, right and down, in words."""
    for by, side, ways in zip(by_px, size, (("left", "right"), ("up", "down")), strict=True):
        if abs(by) > _ASIDE * side:
            yield f"{abs(by):.0f} px {ways[int(by > 0.0)]}"
