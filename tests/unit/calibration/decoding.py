"""Stripes and codes decoded from photos that are there already, as steps do it photo by photo."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.geometry.phase import (
    DecodedQuads,
    PhaseCode,
    Sines,
    check_periods,
    join_axes_on_panel,
)
from pdcd.calibration.geometry.xor import XorCode, XorPlanes
from pdcd.calibration.photo import QuadPhoto

Floats = NDArray[np.float64]


def decode_by_prior(photos: Iterable[QuadPhoto], code: PhaseCode, prior_px: Floats) -> DecodedQuads:
    """Panel pixels out of the photos of `code.shown` for either axis, by a belief (h, w, 2)."""
    taken = iter(photos)
    axes = [_sines(taken, code).place(prior_px[..., axis]) for axis in (0, 1)]
    found = join_axes_on_panel(axes, code)
    check_periods(found, prior_px, code)
    return found


def decode_xor(photos: Iterable[QuadPhoto], code: XorCode) -> DecodedQuads:
    """Panel pixels, whole ones, out of the photos of `code.shown()`, in its order."""
    planes = XorPlanes(code)
    for photo in photos:
        planes.add(photo)
    return planes.decoded()


def _sines(taken: Iterator[QuadPhoto], code: PhaseCode) -> Sines:
    sines = Sines(code, 1)
    for photo in islice(taken, code.steps):
        sines.add(photo)
    sines.refuse_flat()
    return sines
