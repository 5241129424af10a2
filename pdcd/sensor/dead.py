"""Samples that do not follow the light: dead ones in a white photo, stuck ones in test exposures.

Neighbours tell. A lens spreads the light of any point over several samples, so that none stays
dark between lit ones, and none is bright by itself.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools
from pdcd.sensor.cells import CellMap
from pdcd.sensor.profile import SensorProfile
from pdcd.sensor.raw import RawFrame

_BESIDE = tuple(
    turned
    for row in ([[1, 0, 1]], [[1, 0, 0, 0, 1]])
    for turned in (np.array(row, np.uint8), np.array(row, np.uint8).T)
)
"""Samples to either side of one; the next but one tell where two lines lie side by side."""
_AROUND = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
_DEAD = 0.02
"""Light over that to either side below which a sample is dead: black ink has more."""
_SURE = 200.0
"""Read noises of light that a neighbour has at least: noise then makes a live sample of no dead
one."""
_MOST_OF_LINE, _LEAST_OF_LINE = 0.5, 0.25
"""Share of dead samples, of those that can be told, from which all of a row or column is; these
count as a quarter of it, at least."""
_FINE = 1.0 / 15.0
"""Cells that a quad covers, at most, where its neighbours tell of it."""
_STUCK = 0.5
"""Share of saturation that neighbours of a saturated sample stay below where it is stuck."""


def can_tell_samples(cells: CellMap) -> bool:
    """Whether neighbours tell of a sample: not where a few of them, or one, are all of a cell, of
    which a goal may ask for more or less light than of the next."""
    return cells.quad_cells <= _FINE


def find_dead_samples(white: RawFrame, profile: SensorProfile, iso: int) -> Bools:
    """Quads with a dead sample, (h, w), in a photo of all light where `can_tell_samples`. Raises
    ConfigError when the sensor's profile has no such ISO."""
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
    """Saturated quads, (h, w), all of whose neighbours are far from it, where `can_tell_samples`:
    stuck ones, if they are so at another aperture, too; else a glint."""
    if not frame.saturated.any():
        return frame.saturated
    light: NDArray[np.float32] = frame.planes.max(axis=0)
    return np.asarray(frame.saturated & (cv2.dilate(light, _AROUND) < _STUCK * saturation_dn))
