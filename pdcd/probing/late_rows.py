"""Rows of a panel that are set one after the other: when the light of each part of a code comes.

A panel whose last row comes `scan_s` after its first sets its rows in bands, `scan_bands` of them.
Which row a part of a code lies in is said by the panel's map: on one that stands on its head rows
count from below, on one that is turned they depend on the column. All of a window, or of a lit half
cell, comes when the row under its centre does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import PanelConfig
from pdcd.panels.lattice import Lattice
from pdcd.panels.map import Map
from pdcd.panels.placing import placed
from pdcd.panels.windows import LOWER, MOVED, PLACED, UPPER

Times = NDArray[np.int64]


@dataclass(frozen=True)
class Band:
    """Pixels of a panel's fields whose light comes equally late. All of them where `pixels` is
    `slice(None)`."""

    delay_ns: int
    pixels: slice | NDArray[np.intp]

    def count(self, of: int) -> int:
        """How many pixels it has, of so many."""
        return of if isinstance(self.pixels, slice) else int(self.pixels.size)


ALL_AT_ONCE = (Band(0, slice(None)),)

STRIP_CENTRES = {PLACED: 0.5, MOVED: 0.0, LOWER: 0.25, UPPER: 0.75}
"""Centre of a strip from the edge of the code cell that it is numbered by."""


def band_delays_ns(scan_s: float, bands: int) -> Times:
    """When each band of rows is set, after the first one of all, (bands,) int64 in ns.

    scan_s : from the first row until the last one; negative: from the last row until the first.
    """
    if bands == 1:
        return np.zeros(1, dtype=np.int64)
    step = np.arange(bands) / (bands - 1)
    return np.rint(1e9 * (scan_s * step if scan_s > 0 else -scan_s * (1.0 - step))).astype(np.int64)


def bands_of(
    panel: PanelConfig, projector_px: tuple[int, int], lattice: Lattice, *, mask: bool
) -> tuple[Band, ...]:
    """The fields of a panel (`pdcd.panels.lattice`), in bands that come equally late.

    Raises ConfigError for a place that cannot be used.
    """
    height = panel.size_px[1]
    count = min(panel.scan_bands, height)
    if panel.scan_s == 0.0 or count == 1:
        return ALL_AT_ONCE
    map_ = placed(panel.place, panel.size_px, projector_px, "mask" if mask else "projector")
    rows = _rows(map_, _mask_centres(lattice) if mask else _lit_centres(lattice))
    band = rows * count // height
    if mask:  # the rest of the panel stays black: no matter when
        band = np.pad(band, ((0, 0), (0, 1)), mode="edge")
    delays = band_delays_ns(panel.scan_s, count)[band.ravel()]
    return tuple(Band(int(delay), np.flatnonzero(delays == delay)) for delay in np.unique(delays))


def _rows(map_: Map, centres: NDArray[np.float64]) -> NDArray[np.int64]:
    """Row of the panel under each point of the field; where there is none, the nearest."""
    y = map_.from_field(centres)[..., 1]
    height = map_.size_px[1]
    return np.clip(np.floor(np.nan_to_num(y)), 0, height - 1).astype(np.int64)


def _lit_centres(lattice: Lattice) -> NDArray[np.float64]:
    """Centres of the projector's fields, (fields, N, 2) as x, y of the field."""
    quarter = 0.25 if lattice.fields > 1 else 0.0
    places = []
    for field in range(lattice.fields):
        down = np.arange(lattice.grid[0]) + 0.5 + quarter * (2 * (field >> 1) - 1)
        right = np.arange(lattice.grid[1]) + 0.5 + quarter * (2 * (field & 1) - 1)
        places.append(_grid(down, right, lattice.grid))
    return np.stack(places)


def _mask_centres(lattice: Lattice) -> NDArray[np.float64]:
    """Centres of the mask's strips, (dual_fields, L, 2), as x, y of the field."""
    places = []
    for field in range(lattice.dual_fields):
        strips = (STRIP_CENTRES[strip] for strip in lattice.strips(field))
        down, right = (np.arange(n) + at for n, at in zip(lattice.shape, strips, strict=True))
        places.append(_grid(down, right, lattice.grid))
    return np.stack(places)


def _grid(
    down: NDArray[np.floating], right: NDArray[np.floating], grid: tuple[int, int]
) -> NDArray[np.float64]:
    x, y = np.meshgrid(right / grid[1], down / grid[0])
    return np.stack([x.ravel(), y.ravel()], axis=-1)
