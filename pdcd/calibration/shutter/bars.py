"""A bar that runs over the card: its patterns, and reading them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import NO_PATTERNS, Bits, PanelSequence
from pdcd.calibration.timing.strips import CLIPPED, FEWEST_QUADS
from pdcd.calibration.window import WHOLE, Window
from pdcd.errors import CalibrationError
from pdcd.panels.frames import WHITE
from pdcd.panels.map import Map

_CELLS = 32
"""Cells of the bar: a cycle of half a second at 60 Hz."""
_CORE = 0.2
"""Share of a cell that is left out on either side."""
_FAINTEST_SIGMAS = 20.0
"""White over noise of a cell, at least."""


@dataclass(frozen=True, eq=False)
class BarLight:
    """Light of n cells over that of the projector's white, in B bands of the camera's rows.

    value, sigma : (B, n). bands : (B,) middle of each, 0 at the frame's top, 1 at its bottom.
    room : (B, n) light other than the projector's white while the shutter is open, over that white.
        It varies over the picture, because that white falls off to the corners. (1, 1) of 0 where
        it was not measured.
    """

    value: Floats
    sigma: Floats
    bands: Floats
    room: Floats = field(default_factory=lambda: np.zeros((1, 1)))


def make_bar_sequence(
    name: str,
    projector: Map,
    refreshes: int,
    *,
    cells: int = _CELLS,
    window: Window = WHOLE,
) -> PanelSequence:
    """The bar over the height of the field and the width of the `window`; the mask is open
    throughout."""
    patterns = _bar(projector, cells, window)
    index = (np.arange(refreshes) % cells).astype(np.int32)
    opened = np.full(refreshes, WHITE, dtype=np.int32)
    return PanelSequence(name, patterns, NO_PATTERNS, index, opened)


def read_bar(
    photo: QuadPhoto,
    white: QuadPhoto,
    camera: Map,
    *,
    cells: int = _CELLS,
    bands: int = 1,
    window: Window = WHOLE,
    room: QuadPhoto | None = None,
) -> BarLight:
    """How bright the cells are, over a photo in which all of the field was white.

    photo, white : of one size, that of the camera's map.
    room : as white, but with a black projector.
    bands : of the camera's rows, equally high, between the first and the last that see the bar.
        There is a single one where some band does not see all cells, as with a camera turned by a
        quarter.

    Raises CalibrationError: no light, clipped, cells that are not seen.
    """
    centres = camera.centres()
    with np.errstate(invalid="ignore"):
        x = window.across(centres[..., 0]) * cells
        top, bottom = max(0.1, window.top), min(0.9, window.bottom)
        seen = (centres[..., 1] >= top) & (centres[..., 1] < bottom)
        seen &= (x >= 0.0) & (x < cells) & (np.abs(x - np.floor(x) - 0.5) < 0.5 - _CORE)
    rows = np.flatnonzero(seen.any(axis=1))
    if not rows.size:
        raise _unseen("the camera sees nothing of the bar")
    first, end = int(rows[0]), int(rows[-1]) + 1
    row = np.arange(len(seen))
    band = np.clip((row - first) * bands // (end - first), 0, bands - 1)
    cell = np.where(seen, band[:, None] * cells + np.nan_to_num(x).astype(np.int64), -1)
    size, used = bands * cells, seen
    quads = np.bincount(cell[used], minlength=size)
    if bands > 1 and (quads < FEWEST_QUADS).any():
        return read_bar(photo, white, camera, cells=cells, window=window, room=room)
    clipped = max(taken.saturated_share(used) for taken in (photo, white))
    if clipped > CLIPPED:
        raise CalibrationError(
            f"{100.0 * clipped:.0f} % of the bar is saturated",
            device="camera",
            hint="close the aperture, or use a lower ISO",
        )
    if (quads < FEWEST_QUADS).any():
        raise _unseen(f"{np.count_nonzero(quads < FEWEST_QUADS)} cells of the bar are not seen")
    photos = (photo, white) if room is None else (photo, white, room)
    value, sigma, beside = _over_white(photos, used, cell[used], size)
    middle = (first + (np.arange(bands) + 0.5) * (end - first) / bands) / len(seen)
    shape = bands, cells
    return BarLight(value.reshape(shape), sigma.reshape(shape), middle, beside.reshape(shape))


def _over_white(
    photos: Sequence[QuadPhoto],
    used: NDArray[np.bool_],
    cell: NDArray[np.int64],
    cells: int,
) -> tuple[Floats, Floats, Floats]:
    """Light of each cell (cells,) over that of the projector's white, its standard deviation, and
    the room's light over the same.

    photos : the bar, white, and the room's light where it was measured. cell : number of the cell
        of each quad that is `used`. Raises CalibrationError: too dark.
    """
    sums = []
    for taken in photos:
        for values, weights in ((taken.light, taken.shares), (taken.variance, taken.shares**2)):
            sums.append(np.bincount(cell, values[used] @ weights, minlength=cells))
    light, var, full, full_var, *room = (np.asarray(one, dtype=np.float64) for one in sums)
    beside, beside_var = room or (np.zeros(cells), np.zeros(cells))
    full, full_var = full - beside, full_var + beside_var
    if (full < _FAINTEST_SIGMAS * np.sqrt(np.maximum(full_var, 0.0))).any():
        raise CalibrationError(
            "the white photo is dark where the bar runs",
            device="camera",
            hint="take off the lens cap, switch the projector on, and put the card in front of it",
        )
    value = light / full
    return value, np.sqrt(var + value**2 * full_var) / full, beside / full


def _unseen(what: str) -> CalibrationError:
    return CalibrationError(
        what,
        device="camera",
        hint="the camera must see all of the field, and the card must cover it; or use fewer "
        "bands or cells",
    )


def _bar(map_: Map, cells: int, window: Window) -> Bits:
    """(cells, height, width), the pixels of each cell."""
    centres = map_.centres()
    x = window.across(centres[..., 0])
    with np.errstate(invalid="ignore"):
        inside = ((centres >= 0.0) & (centres < 1.0)).all(axis=-1)
        cell = np.where(inside, np.floor(np.nan_to_num(x) * cells), -1.0)
    return np.asarray(np.arange(cells)[:, None, None] == cell)
