"""How bright each strip of a photo is, band by band of the field, over a photo with all white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.timing.programmes import Programme, PulseStrips
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map

_USED = 0.25
"""Share of a strip that is left out on either side: blur and errors of maps do not reach so far."""
FEWEST_QUADS = 16
"""Quads of a strip in a band, at least."""
_DARK = 0.1
"""Light of a strip in the white photo, over the median of all, below which it is not on the
card."""
_GAP = 0.5
"""Light of gaps between strips, over that of the strips, above which they are no gaps."""
CLIPPED = 0.01
"""Largest share of clipped quads."""
_MOST_BESIDE = 0.5
"""Largest light without the projector's white, over all light of a strip, that is believed."""
_UNSEEN = 10.0
"""A uniform light of so many times its noise is added to the room's light, so that where there is
hardly any it counts as the same everywhere."""
_FAINTEST_SIGMAS = 20.0
"""Least white over its noise, in a strip of a band: with less, no time is known to 0.15 ms."""


@dataclass(frozen=True, eq=False)
class StripReadings:
    """Light of K programmes in B bands over that of white.

    value, sigma : (B, K); sigma is of noise alone.
    bands : (B,) middle of each band on the field, y from 0 to 1. height : of a band.
    programmes : (K,) of both panels.
    x : (K,) middle of each strip, less that of the field, x from 0 to 1; 0 for the whole field.
    room : (B, K) light on the mask other than the projector's white, over that white: the room's
        light and the leak of a black projector. The projector's white falls off to the corners, and
        the room's light does not. (1, 1) of 0 where it was not measured.
    past : (B, K) distribution over the field of light that bypasses the mask, over the same white;
        assumed to be that of the room's light. Its mean is 1. (1, 1) where it was not measured.
    off : (B, K) mean position of a strip's light in its band, y less the band's middle.
    """

    value: Floats
    sigma: Floats
    bands: Floats
    height: float
    programmes: tuple[Programme, ...]
    x: Floats = field(default_factory=lambda: np.zeros(1))
    room: Floats = field(default_factory=lambda: np.zeros((1, 1)))
    past: Floats = field(default_factory=lambda: np.ones((1, 1)))
    off: Floats = field(default_factory=lambda: np.zeros((1, 1)))


def read_strips(
    photo: QuadPhoto,
    white: QuadPhoto,
    camera: Map,
    strips: PulseStrips,
    *,
    bands: int,
    gaps: bool = True,
    room: QuadPhoto | None = None,
) -> StripReadings:
    """How bright the strips are in a photo, over one in which all of them were white.

    Parameters
    ----------
    photo, white : of equal exposure and size, that of the camera's map.
    bands : of rows of the field, equally high.
    gaps : whether the white photo has dark gaps between its strips, which are then checked.
    room : the white photo again with a black projector (`make_room_sequence`).

    Raises CalibrationError: no light, clipped, part of the field not covered, strips not where the
    maps say, or out of focus.
    """
    x, y, band = _banded(camera, strips, bands)
    inside = band >= 0
    strip = np.where(inside, strips.number(x, _USED), -1)
    cell = np.where(strip >= 0, band * strips.count + strip, -1)
    size = bands * strips.count
    _check_clipped((photo, white), cell >= 0)
    sums = [_sums(taken, cell, size) for taken in (photo, white)]
    quads = np.bincount(cell[cell >= 0], minlength=size)
    (light, var), (full, full_var) = sums
    _check_white(full, full_var, quads, strips.count)
    if gaps:
        _check_gaps(white, x, inside, strips)
    value = light / full
    sigma = np.sqrt(var + value**2 * full_var) / full
    shape = bands, strips.count
    on_mask, past = np.zeros((1, 1)), np.ones((1, 1))
    if room is not None:
        share, noise, seen = _beside(_sums(room, cell, size), full)
        on_mask, past = (share / (1.0 - share)).reshape(shape), (seen / seen.mean()).reshape(shape)
        # A strip has the room's light while its mask is open, less its share of the white it is
        # divided by.
        opened = np.tile([np.mean(p.on[1]) for p in strips.programmes], bands)
        sigma = np.hypot(sigma, np.abs(opened - value) * noise)
    height = (strips.window.bottom - strips.window.top) / bands
    used = cell >= 0
    within = white.light[used] @ white.shares * (y[used] * bands - band[used] - 0.5)
    off = height * np.bincount(cell[used], within, size) / full
    return StripReadings(
        value.reshape(shape),
        sigma.reshape(shape),
        strips.window.y((np.arange(bands) + 0.5) / bands),
        height,
        strips.programmes,
        strips.window.x((np.arange(strips.count) + 0.5) / strips.count) - 0.5,
        on_mask,
        past,
        off.reshape(shape),
    )


def _banded(
    camera: Map, strips: PulseStrips, bands: int
) -> tuple[Floats, Floats, NDArray[np.int32]]:
    """For each quad: x on the field, y from top to bottom of the strips, and the band in which it
    lies, -1 outside of them; (rows, cols) each."""
    centres = camera.centres()
    y = strips.window.down(centres[..., 1])
    with np.errstate(invalid="ignore"):
        inside = (y >= 0.0) & (y < 1.0)
    band = np.where(inside, np.nan_to_num(y) * bands, -1).astype(np.int32)
    return centres[..., 0], y, band


def _beside(room: tuple[Floats, Floats], full: Floats) -> tuple[Floats, Floats, Floats]:
    """Light other than the projector's white over all light, its noise, and its distribution over
    the field, (size,) each: where there is hardly any, that is taken as uniform."""
    noise = np.sqrt(room[1]) / full
    share = np.minimum(room[0] / full, _MOST_BESIDE)
    return share, noise, np.maximum(share, 0.0) + _UNSEEN * noise


def _sums(taken: QuadPhoto, cell: NDArray[np.int32], size: int) -> tuple[Floats, Floats]:
    """Light of all quads of each cell and its variance, (size,) each; clipped quads are included,
    because there are few."""
    used = cell >= 0
    light = taken.light[used] @ taken.shares
    var = taken.variance[used] @ taken.shares**2
    where = cell[used]
    sums = (np.bincount(where, weights, minlength=size) for weights in (light, var))
    first, second = (np.asarray(found, dtype=np.float64) for found in sums)
    return first, second


def _check_clipped(photos: Sequence[QuadPhoto], used: NDArray[np.bool_]) -> None:
    worst = max(taken.saturated_share(used) for taken in photos)
    if worst > CLIPPED:
        raise CalibrationError(
            f"{100.0 * worst:.0f} % of the photo is saturated",
            device="camera",
            hint="close the aperture, or use a lower ISO",
        )


def _check_white(full: Floats, var: Floats, quads: NDArray[np.int64], across: int) -> None:
    """Raise CalibrationError for a white photo without light, or one that does not show all of the
    field."""
    seen = quads >= FEWEST_QUADS
    if not seen.any():
        raise CalibrationError(
            "the camera sees nothing of the field",
            device="camera",
            hint="run the geometry step first; if that was done, use fewer bands",
        )
    mean = full / np.maximum(quads, 1)
    bright = seen & (full > _FAINTEST_SIGMAS * np.sqrt(np.maximum(var, 0.0)))
    if not bright.any():
        raise CalibrationError(
            "the white photo is dark",
            device="camera",
            hint="take off the lens cap, switch the projector on, and put the card in front of it",
        )
    lit = bright & (mean > _DARK * np.median(mean[bright]))
    if not lit.all():
        columns = np.count_nonzero(~lit.reshape(-1, across).any(axis=0)) if across > 1 else 0
        raise CalibrationError(
            f"{np.count_nonzero(~lit)} of {lit.size} parts of the field have no light in the white "
            f"photo ({columns} of {across} strips in none of their rows)",
            device="camera",
            hint="the card must cover the whole field, and the camera must see all of it",
        )


def _check_gaps(
    white: QuadPhoto,
    x: Floats,
    inside: NDArray[np.bool_],
    strips: PulseStrips,
) -> None:
    """Raise CalibrationError where strips of the white photo do not end where those of the mask
    do."""
    width, field_x, x = strips.count, x, strips.window.across(x)
    with np.errstate(invalid="ignore"):
        away = np.abs(x * width - np.rint(x * width)) / strips.inset  # from the nearest edge
        border = (np.rint(x * width) > 0) & (np.rint(x * width) < width)
    gap = inside & border & (away < 0.4)
    core = inside & (strips.number(field_x, _USED) >= 0)
    levels = [
        float(np.mean(white.light[part] @ white.shares)) for part in (gap, core) if part.any()
    ]
    if len(levels) == 2 and levels[0] > _GAP * levels[1]:
        raise CalibrationError(
            f"gaps between the strips have {100.0 * levels[0] / levels[1]:.0f} % of their light",
            device="mask",
            hint="focus the relay and the camera, or run the geometry step again: the strips are "
            "not where its maps say",
        )
