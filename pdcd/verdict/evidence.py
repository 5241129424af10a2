"""What the verdict on a run looks at: its matrices, and some pixels of its pictures and shots.

All that looks at pixels looks at some `_PIXELS` of them, evenly spread, and at means over cells of
those. So it takes the same few hundredths of a second for a frame of any size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.pictures.darkroom import DecodedRun
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.transport import TransportSlice
from pdcd.probing.deviation import Deviation
from pdcd.probing.realised import Factors, sum_signed_factors
from pdcd.recipes.recipe import Extremes, Recipe, RecipePhoto, Shot
from pdcd.sensor.cells import CellMap
from pdcd.verdict.placement import LightSample
from pdcd.words import NormaliseName

_PIXELS = 2**14
"""Pixels that are looked at, at most four times as many."""
PIXELS_PER_CELL = 4
"""The same for each cell, where that is more: of those that see the field."""


@dataclass(frozen=True)
class PixelSample:
    """Every `step`-th pixel, down and right; `cell` (n,) of each, -1 outside the field."""

    step: int
    cell: NDArray[np.int64]
    cells: int

    @classmethod
    def of(cls, cells: CellMap) -> PixelSample:
        """Pixels of a frame, with the cell that the centre of each lies in."""
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

    def blown(self, shot: ExposedShot) -> NDArray[np.bool_]:
        """(n,), where it is saturated."""
        return shot.saturated[self._each, self._each].ravel()

    def _flat(self, some: NDArray[Any]) -> Floats:
        return np.asarray(some, dtype=np.float64).reshape(self.cell.size, -1)

    @property
    def _each(self) -> slice:
        return slice(self.step // 2, None, self.step)

    def inside(self, values: Floats) -> Floats:
        """Those of the field."""
        return values[self.cell >= 0]

    def outside(self, values: Floats) -> Floats:
        """Those beside the field."""
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
    """What is known of a run whose pictures were made.

    photos : those that the answer is made of. names : of their shots, single codes included.
    planned : shots as the recipe has them. panels : shots and weighted sums of them, by name, as
    the photos name them. deviations : of photos from what was wanted. apart : of photos, the share
    of the field in which the panels showed different cells. takes_out : whether direct light was
    taken out of a photo. thin : the pixels that are looked at. field : (h, w), quads that lie
    wholly within the field.
    """

    recipe: Recipe
    photos: tuple[RecipePhoto, ...]
    names: tuple[str, ...]
    planned: Mapping[str, Shot]
    shots: Mapping[str, ExposedShot]
    panels: Mapping[str, ExposedShot]
    pictures: Mapping[str, PictureWithErrors]
    answer: PictureWithErrors
    transport: TransportSlice | None
    deviations: Mapping[str, Deviation]
    apart: Mapping[str, float]
    takes_out: Callable[[RecipePhoto, NormaliseName], bool]
    thin: PixelSample
    field: Bools

    @classmethod
    def of(
        cls, decoded: DecodedRun, cells: CellMap, deviations: Mapping[str, Deviation]
    ) -> Evidence:
        """That of a run that was decoded; `cells` is the map of its frame."""
        recipe = decoded.recipe
        rule = recipe.answer
        named = rule.photos if isinstance(rule, Extremes) else [name for _, name in rule]
        photos = tuple(photo for photo in recipe.photos if photo.name in set(named))
        return cls(
            recipe=recipe,
            photos=photos,
            names=tuple(dict.fromkeys(_shots_of(photos, decoded))),
            planned={shot.name: shot for shot in recipe.shots},
            shots=decoded.shots,
            panels={**decoded.shots, **decoded.sums},
            pictures=decoded.pictures,
            answer=decoded.answer,
            transport=decoded.transport,
            deviations=deviations,
            apart={photo.name: decoded.apart_in(photo) for photo in photos},
            takes_out=decoded.takes_out,
            thin=PixelSample.of(cells),
            field=cells.known,
        )

    def inside(self, image: NDArray[Any]) -> Floats:
        """Values of a picture (h, w, C) at the pixels of the field that are looked at, (n, C)."""
        return self.thin.inside(self.thin.pick(image))

    def sample(self, terms: Iterable[tuple[float, str]]) -> LightSample:
        """A signed sum of shots, by the means of its cells."""
        thin = self.thin
        shots = [(sign, self.shots[name]) for sign, name in terms]
        grey = sum((s * thin.light(e).mean(axis=1) for s, e in shots), np.zeros(len(thin.cell)))
        blown = np.logical_or.reduce([thin.blown(e) for _, e in shots])
        realised: Factors = sum_signed_factors((sign, shot.realised) for sign, shot in shots)
        return LightSample(thin.mean(grey, blown), realised)


def _shots_of(photos: Iterable[RecipePhoto], decoded: DecodedRun) -> Iterator[str]:
    for photo in photos:
        for _, name in photo.shots:
            if name in decoded.shots:
                yield name
            else:
                yield from decoded.recipe.stack
