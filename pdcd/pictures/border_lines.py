"""Lines along the borders of whole cells in a photo of indirect light: direct light that gets from
one cell through the mask of the next.

No scene knows where cells end, so a photo without such light has no lines there. The height of the
lines, over the direct light beside them, measures how far light is blurred on its way to the mask,
or how far the mask lies elsewhere, beyond what was known and taken out. Thousands of borders
together measure it far more finely than photos of blocks can (`pdcd.pictures.block_blur`), but only
for whole cells, and in the photo itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.pictures.combine import list_white_photos
from pdcd.pictures.misplaced import mean_cell_px
from pdcd.pictures.picture import Picture, PictureWithErrors
from pdcd.recipes.recipe import Recipe
from pdcd.runs.record import RunRecord
from pdcd.sensor.cells import CellMap
from pdcd.sensor.raw import shrink_image

_REACH = 0.01
"""Share of a cell's side that counts as its border."""
_PASSED = 1.0 / np.sqrt(2.0 * np.pi)
"""Light that crosses a border, over the blur: the integral of a normal tail on either side."""
_FEWEST_QUADS, _ENOUGH_QUADS = 2.5, 8.0
"""Quads along a side of a cell from which lines can be seen, and to which finer ones are binned."""
_BESIDE = 1.5
"""Standard deviation, in quads, of the weighted mean that a line is compared with."""
_LIT = 0.02
"""Share of the bright quads' light below which a quad is not used."""
_ROUNDS = 4
"""Iterations that estimate direct light from a photo without the light that got into it."""
_PATCH_CELLS, _FEWEST_PATCHES = 3.0, 8
"""Side, in cells, of the patches of the field that each give an estimate of the lines, and how many
of these it takes: a scene may have an edge along a border here and there, but not everywhere."""
_SURE = 3.0
"""Standard deviations from which lines count as found."""


def measure_border_blur(
    record: RunRecord, recipe: Recipe, pictures: Mapping[str, PictureWithErrors], cells: CellMap
) -> float:
    """Standard deviation, in projector pixels, of the blur beside the known one that would make the
    lines along borders in photos of indirect light; 0 where there are none, or too few to measure.

    Caller: `pdcd.pictures.darkroom`, for the error bars and the verdict.
    """
    if cells.map is None:
        return 0.0
    found = [
        _measure_lines(pictures[name], pictures[white], cells)
        for name, white in find_line_pictures(record, recipe, cells)
        if name in pictures and white in pictures
    ]
    return max(found, default=0.0) * mean_cell_px(record)


def find_line_pictures(
    record: RunRecord, recipe: Recipe, cells: CellMap
) -> Iterator[tuple[str, str]]:
    """Names of the pictures of indirect light in which lines along borders of cells would show, and
    of the white picture beside each: none where cells have too few quads.

    Callers: `measure_border_blur`, and the verdict, which trusts a photo less where none can show.
    """
    if cells.quad_cells * _FEWEST_QUADS**2 > 1.0:
        return
    windows = {shot.name: shot.window for shot in record.shots}
    alone = {
        photo.name: name
        for photo in recipe.photos
        for name, rule in recipe.pictures.items()
        if rule == ((1.0, photo.name),)
    }
    white = [alone[name] for name in list_white_photos(recipe) if name in alone]
    for photo in recipe.photos if white else ():
        indirect = photo.wanted.uniform == (0.0, 1.0) and photo.name in alone
        if indirect and windows.get(photo.shots[0][1]) == "whole":
            yield alone[photo.name], white[-1]


def _measure_lines(indirect: Picture, white: Picture, cells: CellMap) -> float:
    """The blur by the lines of one photo, in cells."""
    side = int(cells.quad_cells**-0.5 / _ENOUGH_QUADS)
    side = next((n for n in range(side, 1, -1) if cells.can_bin(n)), 1)
    small = cells.binned(side)
    known = small.known.copy()
    light, all_light = (_shrink(one, side, known) for one in (indirect, white))
    known &= all_light > _LIT * np.percentile(all_light[known], 95.0) if known.any() else False
    share = np.divide(light, all_light, out=np.zeros(light.shape), where=known)
    at = np.where(known[..., None], small.centres * small.grid[::-1] / _PATCH_CELLS, 0.0)
    across, down = np.moveaxis(at.astype(np.intp), -1, 0)
    patch = down * (across.max(initial=0) + 1) + across
    heights = [_fit_height(share, border, known, patch) for border in _map_borders(small)]
    return float(np.sqrt(np.mean(np.square(heights))))


def _shrink(picture: Picture, side: int, known: Bools) -> Floats:
    """Grey light of squares of quads, (h, w). Squares with an unknown quad are taken out of
    `known`."""
    lost = ~np.isfinite(picture.sigma).all(axis=-1)
    grey: Floats = np.where(lost, 0.0, picture.image.mean(axis=-1, dtype=np.float64))
    if side > 1:
        lost = shrink_image(np.asarray(lost, np.float32), side) > 0.0
        grey = shrink_image(np.asarray(grey, np.float32), side).astype(np.float64)
    known &= ~lost
    return grey


def _map_borders(cells: CellMap) -> tuple[Floats, Floats]:
    """Share of the direct light that crosses borders where each quad looks, (h, w): those to the
    left and right, and those above and below; for a blur of one cell, if it were proportional."""
    cut, beside = (0.0, _REACH, 1.0 - _REACH, 1.0), np.array([[1.0, 0.0, 1.0]])
    across = cells.gather(np.tile(beside, cells.grid), ((0.0, 1.0), cut))
    down = cells.gather(np.tile(beside.T, cells.grid), (cut, (0.0, 1.0)))
    return _PASSED / _REACH * across, _PASSED / _REACH * down


def _fit_height(share: Floats, border: Floats, known: Bools, patch: NDArray[np.intp]) -> float:
    """Height of lines in a share of indirect light, over `border`, (h, w) each: the median over
    patches. patch : (h, w), the number of each quad's."""
    weight = np.maximum(scipy.ndimage.gaussian_filter(known.astype(np.float64), _BESIDE), 1e-3)

    def level_out(values: Floats) -> tuple[Floats, Floats]:
        """How much values exceed the mean of those around, and that mean: (n,) each."""
        inside = np.where(known, values, 0.0)
        level = scipy.ndimage.gaussian_filter(inside, _BESIDE) / weight
        return (inside - level)[known], level[known]

    (lifted, around), (lines, usual) = level_out(share), level_out(border)
    height, error = 0.0, 0.0
    for _ in range(_ROUNDS):
        # Scaled by the light around: the line's own varies with the scene, as the share does. The
        # light that got into the photo is missing from the difference taken for direct light.
        line = lines * (1.0 - around) / np.maximum(1.0 - height * usual, 0.5)
        along, power = (np.bincount(patch[known], each) for each in (line * lifted, line**2))
        told = power > 0.1 * np.max(power, initial=0.0)
        if np.count_nonzero(told) < _FEWEST_PATCHES:
            return 0.0
        heights = along[told] / power[told]
        height = max(float(np.median(heights)), 0.0)
        spread = float(np.median(np.abs(heights - np.median(heights))))
        error = 1.4826 * np.sqrt(np.pi / 2.0) * spread / np.sqrt(heights.size)
    return height if height > _SURE * error else 0.0
