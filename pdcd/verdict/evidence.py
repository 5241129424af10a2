"""What the verdict on a run is based on: its matrices, and some pixels of its pictures and shots.

Instead of all pixels the verdict uses about `_PIXELS` of them, evenly spread, and their means over
cells. So it takes the same few hundredths of a second for a frame of any size.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.pictures.decoded_run import DecodedRun
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.picture import PictureWithErrors
from pdcd.probing.deviation import Deviation
from pdcd.probing.realised import Factors, sum_signed_factors
from pdcd.recipes.recipe import RecipePhoto, Shot
from pdcd.runs.record import RunRecord, ShotRecord
from pdcd.sensor.cells import CellMap
from pdcd.verdict.placement import LightSample

_PIXELS = 2**14
"""Number of pixels that are used, and up to four times as many."""
PIXELS_PER_CELL = 4
"""Pixels of the field per cell that are used, where that gives more."""
_STACK = 24
"""Most photos of single codes that are used."""


@dataclass(frozen=True)
class PixelSample:
    """Every `step`-th pixel, down and right; `cell` (n,) of each, -1 outside the field."""

    step: int
    cell: NDArray[np.int64]
    cells: int

    @classmethod
    def of(cls, cells: CellMap) -> PixelSample:
        """Pixels of a frame, each with the cell that its centre lies in."""
        (rows, cols), (height, width) = cells.grid, cells.frame
        field_share = max(float(np.mean(cells.known)), 1.0 / (height * width))
        least = max(_PIXELS, PIXELS_PER_CELL * rows * cols / field_share)
        step = max(1, int(np.sqrt(height * width / least)))
        x, y = np.meshgrid(np.arange(step // 2, width, step), np.arange(step // 2, height, step))
        field = cells.filled.to_field(np.stack([x, y], axis=-1) + 0.5).reshape(-1, 2)
        with np.errstate(invalid="ignore"):  # beyond the horizon
            inside = np.asarray(((field >= 0.0) & (field < 1.0)).all(axis=1))
        right, down = np.floor(np.where(inside[:, None], field, 0.0) * (cols, rows)).T
        cell = np.where(inside, down * cols + right, -1.0).astype(np.int64)
        return cls(step, cell, rows * cols)

    def pick(self, image: NDArray[Any]) -> Floats:
        """(h, w, C) -> (n, C)."""
        return self._flat(image[self._each, self._each])

    def light(self, shot: ExposedShot) -> Floats:
        """(n, C), light of a shot."""
        return self._flat(shot.light_at(self._each, self._each))

    def variance(self, shot: ExposedShot) -> Floats:
        """(n, C), its variance."""
        return self._flat(shot.variance_at(self._each, self._each))

    def _flat(self, some: NDArray[Any]) -> Floats:
        return np.asarray(some, dtype=np.float64).reshape(self.cell.size, -1)

    @property
    def _each(self) -> slice:
        return slice(self.step // 2, None, self.step)

    def inside(self, values: Floats) -> Floats:
        """The values inside the field."""
        return values[self.cell >= 0]

    def outside(self, values: Floats) -> Floats:
        """The values outside the field."""
        return values[self.cell < 0]

    def mean(self, values: Floats, blown: NDArray[np.bool_]) -> Floats:
        """(n,) -> mean over each cell (N,) of pixels that are not `blown`, NaN where none is."""
        known = (self.cell >= 0) & ~blown
        count = np.bincount(self.cell[known], minlength=self.cells)
        total = np.bincount(self.cell[known], values[known], minlength=self.cells)
        mean: Floats = np.full(self.cells, np.nan)
        np.divide(total, count, out=mean, where=count > 0)
        return mean


@dataclass(frozen=True, eq=False)
class Evidence:
    """A run whose pictures were made, and those of its data that the verdict uses.

    cells : the map of its frame. deviations : of photos from what was wanted.
    """

    record: RunRecord
    cells: CellMap
    decoded: DecodedRun
    deviations: Mapping[str, Deviation]

    @cached_property
    def photos(self) -> list[RecipePhoto]:
        """The photos that the answer is made of."""
        return list(self.decoded.recipe.answer_photos)

    @cached_property
    def names(self) -> list[str]:
        """Names of the shots of these photos, single codes included."""
        return list(self.decoded.recipe.answer_shots)

    @cached_property
    def thin(self) -> PixelSample:
        """The pixels that are used."""
        return PixelSample.of(self.cells)

    @property
    def pictures(self) -> Mapping[str, PictureWithErrors]:
        """All pictures, by name."""
        return self.decoded.pictures

    @cached_property
    def planned(self) -> dict[str, Shot]:
        """Shots as the recipe has them, by name."""
        return {shot.name: shot for shot in self.decoded.recipe.shots}

    @cached_property
    def records(self) -> list[ShotRecord]:
        """The records of the shots that the answer is made of."""
        names = set(self.names)
        return [shot for shot in self.record.shots if shot.name in names]

    @cached_property
    def window(self) -> str:
        """The mask's windows in the first of these shots that is not white; "whole" without one."""
        windows = {shot.name: shot.window for shot in self.records}
        shown = (windows[n] for n in self.names if n in windows and not self.planned[n].white)
        return next(shown, "whole")

    @cached_property
    def panels(self) -> dict[str, ExposedShot]:
        """Shots and weighted sums of them, by the names that photos use."""
        return {**self.decoded.shots, **self.decoded.sums}

    def inside(self, image: NDArray[Any]) -> Floats:
        """Values of a picture (h, w, C) at the sampled pixels of the field, (n, C)."""
        return self.thin.inside(self.thin.pick(image))

    def sample(self, terms: Iterable[tuple[float, str]]) -> LightSample:
        """A signed sum of shots, as means over its cells."""
        thin = self.thin
        shots = [(sign, self.decoded.shots[name]) for sign, name in terms]
        grey = sum((s * thin.light(e).mean(axis=1) for s, e in shots), np.zeros(len(thin.cell)))
        blown = np.any([thin.pick(e.saturated)[:, 0] for _, e in shots], axis=0)
        realised: Factors = sum_signed_factors((sign, shot.realised) for sign, shot in shots)
        return LightSample(thin.mean(grey, blown), realised)


def compute_rms(values: Floats) -> float:
    """RMS of the values that are known; 0 where none is."""
    known = np.isfinite(values)
    return float(np.sqrt(np.mean(values[known] ** 2))) if known.any() else 0.0


def list_evenly(names: Sequence[str]) -> Sequence[str]:
    """At most `_STACK` of the names, evenly spread."""
    return names[:: -(-len(names) // _STACK)] if names else names
