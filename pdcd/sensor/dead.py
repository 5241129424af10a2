"""Samples that do not follow the light: dead ones in a white photo, stuck ones in test exposures,
full ones of a sensor that holds less than its profile says.

Neighbours show the first two: a lens spreads the light of any point over several samples, so that
no live sample stays dark between lit ones or is bright on its own. Noise shows the third: full
samples have no photon noise, so that far more of them end at one level than just below it.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import SensorProfile, compute_variance_dn2
from pdcd.sensor.raw import RawFrame

_BESIDE = tuple(
    turned
    for row in ([[1, 0, 1]], [[1, 0, 0, 0, 1]])
    for turned in (np.array(row, np.uint8), np.array(row, np.uint8).T)
)
"""Samples to either side of one: the next ones, and the next but one for two dead lines side by
side."""
_AROUND = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
_DEAD = 0.02
"""Light relative to that at either side, below which a sample is dead: black ink has more."""
_SURE = 200.0
"""Least light of a neighbour, in read noises: noise then cannot make a dead sample look live."""
_MOST_OF_LINE, _LEAST_OF_LINE = 0.5, 0.25
"""Share of dead samples, among those lit enough to judge, from which a whole row or column counts
as dead; the judged ones count as at least a quarter of the line."""
_FINE = 1.0 / 15.0
"""Largest area of a quad, in cells, for which its neighbours show what it should see."""
_STUCK = 0.5
"""Share of saturation below which all neighbours of a stuck sample stay."""
_UNLIT = 0.02
"""Share of saturation below which neighbours show that hardly any light falls: a point bright
enough to fill a sample would give its neighbours more, as a lens spreads its light."""
_PILE, _PILE_TIMES = 64, 4
"""Least number of samples at the upper end that show it is full, and their least ratio to those in
an equal range below it: photon noise never piles up so many."""
_READ_SPREAD = 7.0
"""Read noises between the brightest of many full samples and nearly the darkest."""
_LEAST_NOISE = 3.0
"""Least noise of the brightest light, in read noises, at which the two can be separated."""
_NOISY, _QUARTER = 0.5, 0.3186
"""Least noise of a photo, relative to the noise model, for its noise to show full samples; and the
lower quartile of differences by noise, in standard deviations."""


def can_tell_samples(cells: CellMap) -> bool:
    """Whether neighbours show what a sample should see. They do not where a cell is only a few
    samples, or one: a goal may ask for more or less light from it than from the next cell."""
    return cells.quad_cells <= _FINE


def find_dead_samples(white: RawFrame, profile: SensorProfile, iso: int) -> Bools:
    """Quads with a dead sample, (h, w), in a photo of all light. Use it where `can_tell_samples`.
    Raises ConfigError when the sensor's profile has no such ISO."""
    row = profile.row(iso)
    least = _SURE * row.read_noise_e / row.gain_e_per_dn
    found = np.zeros(white.frame, np.bool_)
    for light in white.planes:
        sides = [cv2.erode(light, pair, borderType=cv2.BORDER_CONSTANT, borderValue=0.0)
                 for pair in _BESIDE]  # fmt: skip
        beside = np.maximum.reduce(sides)
        lit = beside > least
        dead = lit & (light < _DEAD * beside)
        if not dead.any():
            continue
        for axis in (0, 1):
            told = np.maximum(lit.sum(axis=axis), _LEAST_OF_LINE * light.shape[axis])
            dead |= np.expand_dims(dead.sum(axis=axis) > _MOST_OF_LINE * told, axis)
        found |= dead
    return found


def find_stuck_samples(frame: RawFrame, saturation_dn: float) -> Bools:
    """Saturated quads, (h, w), all of whose neighbours are far from saturation. Use it where
    `can_tell_samples`. Quads that stay so at another aperture are stuck, others are a glint."""
    if not frame.saturated.any():
        return frame.saturated
    return np.asarray(frame.saturated & (_light_around(frame) < _STUCK * saturation_dn))


def find_always_full_samples(quads: Bools, frames: Iterable[tuple[RawFrame, float]]) -> Bools:
    """Those of some quads, (h, w), that are white whatever they see. Use it where
    `can_tell_samples`. They are saturated in all photos of a run, and in one of them alone among
    dark neighbours, as the projector's code is black there. `frames` are the photos, each with its
    DN of saturation."""
    always, dark = quads.copy(), np.zeros_like(quads)
    for frame, saturation_dn in frames:
        always &= frame.saturated
        if not always.any():
            break
        dark |= always & (_light_around(frame) < _UNLIT * saturation_dn)
    return always & dark


def _light_around(frame: RawFrame) -> NDArray[np.float32]:
    """The brightest sample of the quads around each quad, (h, w), in DN above black."""
    light: NDArray[np.float32] = frame.planes.max(axis=0)
    return np.asarray(cv2.dilate(light, _AROUND), np.float32)


def find_full_level(frame: RawFrame, profile: SensorProfile, iso: int) -> float | None:
    """DN above black from which samples of a photo are full, if that is below what the profile
    says; None where no samples are. Raises ConfigError when the profile has no such ISO."""
    free = frame.samples
    if frame.saturated.any():
        free = np.where(frame.saturated, free.dtype.type(0), free)
    top = max(float(light.max()) - black for light, black in zip(free, frame.black, strict=True))
    read_dn, noise_dn = np.sqrt(compute_variance_dn2([0.0, top], profile, iso, 0.0))
    if noise_dn < _LEAST_NOISE * read_dn:
        return None
    width = max(0.5 * noise_dn, _READ_SPREAD * read_dn)
    full = _count_from(free, frame.black + (top - width))
    if full < _PILE:
        return None
    below = _count_from(free, frame.black + (top - 2.0 * width)) - full
    if full < _PILE_TIMES * below or not _has_noise(frame, profile, iso, top - width):
        return None
    return float(top - width)


def _count_from(samples: NDArray[np.generic], levels: Floats) -> int:
    """Number of samples of all planes at or above these levels; whole numbers are compared as whole
    numbers."""
    whole = np.ceil(levels).astype(np.int64) if samples.dtype == np.uint16 else levels
    found = (light >= level for light, level in zip(samples, whole.tolist(), strict=True))
    return sum(int(np.count_nonzero(where)) for where in found)


def mark_full_samples(frame: RawFrame, level_dn: float) -> RawFrame:
    """The photo with quads marked as saturated from that level above black on."""
    return frame.without(np.asarray((frame.planes >= np.float32(level_dn)).any(axis=0)))


def _has_noise(frame: RawFrame, profile: SensorProfile, iso: int, below_dn: float) -> bool:
    """Whether neighbouring samples below a level differ by as much as the noise of their light. In
    an average of many photos, or with a sensor without noise, an even wall also ends at one level.
    """
    ratios = []
    for light in frame.planes:
        one, other = light[:, :-1:2], light[:, 1::2]
        mean = 0.5 * (one + other)
        where = (mean > 0.1 * below_dn) & (np.maximum(one, other) < below_dn)
        noise = np.sqrt(2.0 * compute_variance_dn2(mean[where], profile, iso, 0.0))
        ratios.append(np.abs(one[where] - other[where]) / noise)
    every = np.concatenate(ratios)
    # Edges differ by more than noise; in even cells without noise, a quarter do not differ at all.
    return bool(every.size) and float(np.quantile(every, 0.25)) > _NOISY * _QUARTER
