"""Correspondences of an off-axis bench, from what a calibration measures.

There are two ways. Stripes on the scene itself show which projector pixel lights each quad
(`geometry.phase`): `measure_disparities` turns that into what a request takes. A calibration with a
card at some depth has the camera's map onto that card; compared with the map in use, it gives the
card's plane: `fit_card_plane`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.calibration.geometry.phase import DecodedQuads
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map
from pdcd.panels.placing import project_points

_LEAST_SHARE = 0.25
"""Share of a cell's quads that must be decoded."""
_PLACES = 24
"""Places along either axis of the field at which two maps are compared."""


@dataclass(frozen=True, eq=False)
class Disparities:
    """Where on the projector's field the light of the camera's cells comes from.

    right, down : (rows, cols), in cells from the camera's cell; NaN where too few quads are
        decoded.
    """

    right: Floats
    down: Floats

    @property
    def known(self) -> Bools:
        """(rows, cols): whether the disparity of a cell is known."""
        return np.asarray(np.isfinite(self.right))

    @property
    def off_rows_cells(self) -> float:
        """How far light leaves its row, root mean square: 0 on a rectified bench."""
        return float(np.sqrt(np.mean(self.down[self.known] ** 2)))

    def as_asked(self) -> Floats:
        """The array `disparities` of a request; unknown cells point beyond the field."""
        return np.where(self.known, np.nan_to_num(self.right), 2.0 * self.right.shape[1])


def measure_disparities(
    decoded: DecodedQuads, camera: Map, projector: Map, grid: tuple[int, int]
) -> Disparities:
    """The median of what the quads of each cell see.

    Parameters
    ----------
    decoded : projector pixels of all quads.
    camera, projector : maps to the field, that of the camera from quads.
    grid : rows and columns of cells.

    Raises CalibrationError where no cell is known.
    """
    rows, cols = grid
    height, width = decoded.valid.shape
    quads = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    size = np.array([cols, rows], dtype=np.float64)
    here = camera.to_field(quads) * size
    there = projector.to_field(decoded.panel_px) * size
    with np.errstate(invalid="ignore"):
        inside = ((here >= 0.0) & (here < size)).all(axis=-1)
    cell = np.full(decoded.valid.shape, -1, dtype=np.int64)
    place = np.floor(here[inside]).astype(np.int64)
    cell[inside] = place[:, 1] * cols + place[:, 0]
    good = inside & decoded.valid & np.isfinite(there).all(axis=-1)
    all_of = np.bincount(cell[inside], minlength=rows * cols)
    moved = _medians(cell[good], (there - here)[good], rows * cols)
    few = np.bincount(cell[good], minlength=rows * cols) < np.maximum(_LEAST_SHARE * all_of, 1.0)
    moved[few] = np.nan
    if few.all():
        raise CalibrationError(
            "no cell of the scene could be matched with the projector", device="camera"
        )
    return Disparities(moved[:, 0].reshape(grid), moved[:, 1].reshape(grid))


def fit_card_plane(now: Map, then: Map) -> tuple[tuple[float, ...], float]:
    """The plane of a card, as `plane` of a request or of [rig], and the residual, in fields.

    Parameters
    ----------
    now : the camera's map in use. then : its map by a calibration with a card in that plane. The
        projector has not moved, and its picture is the field in both.

    Raises CalibrationError where the two have no field in common.
    """
    step = (np.arange(_PLACES) + 0.5) / _PLACES
    points = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    places = then.to_field(now.from_field(points))
    good = np.isfinite(places).all(axis=1)
    found = None
    if good.sum() >= 4:
        found, _ = cv2.findHomography(points[good], places[good])
    if found is None:
        raise CalibrationError("the two maps of the camera have no field in common")
    plane = tuple(float(v) for v in (found / found[2, 2]).ravel())
    left = project_points(plane, points[good]) - places[good]
    return plane, float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


def _medians(group: NDArray[np.int64], values: Floats, count: int) -> Floats:
    """Medians (count, 2) of the values (n, 2) of each group; NaN for an empty group."""
    found = np.full((count, values.shape[1]), np.nan)
    if not group.size:
        return found
    order = np.argsort(group, kind="stable")
    numbers, starts = np.unique(group[order], return_index=True)
    for number, part in zip(numbers, np.split(values[order], starts[1:]), strict=True):
        found[number] = np.median(part, axis=0)
    return found
