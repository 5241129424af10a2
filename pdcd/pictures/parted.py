"""What the parts of a coded photo show, each by itself: the means of its cells.

Nothing finer is asked of a part, as its error is wanted cell by cell. So the shots are averaged
over cells first, once each, and all parts are worked out on these few values. A part then has the
weight of a cell where the photo has that of each quad; it is the same in all parts, whose
differences alone are looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.panels.map import Map
from pdcd.pictures.cell_light import Apart, Bools, told_apart
from pdcd.pictures.combine import Floats, Picture, pictures_of
from pdcd.pictures.exposed import Exposed, Print
from pdcd.pictures.quads import image_of_cells, means, of_cells, shared_out
from pdcd.pictures.sigma import Barred, barred, measured
from pdcd.recipes.parts import only_parts, part_numbers
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap

FINE = 1.6
"""Quads along a side of half a cell, beyond what a blur smears, from which parts are averaged over
halves: of fewer, too few see one half alone."""
MANY = 400
"""Quads in a cell, or in half of one, from which those that see another as well do not count: they
lessen what the codes err by 1 % or less."""
SMEARED = 3.0
"""Standard deviations of a blur that count as smeared."""
Photos = Callable[[Recipe, Mapping[str, Exposed], CellMap], dict[str, Picture]]
"""Scales and corrects the photos of a recipe."""


def part_images(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    cells: CellMap,
    photos: Photos,
    *,
    averaged_from: CellMap,
) -> dict[str, list[Floats]]:
    """Every picture as each part alone makes it, (rows, cols, 3) in scene units: of cells, or of
    their `pieces`.

    shots, cells : of `averaged`. averaged_from : the map of the camera.
    """
    unseen = np.flatnonzero(~pieces(averaged_from).seen())
    found: dict[str, list[Floats]] = {name: [] for name in recipe.pictures}
    for number in part_numbers(recipe):
        part = only_parts(recipe, {number})
        for name, picture in pictures_of(part, photos(part, shots, cells)).items():
            whole = cells.map is None
            image = image_of_cells(picture, cells) if whole else picture.image.copy()
            image.reshape(-1, image.shape[2])[unseen] = 0.0
            found[name].append(image)
    return found


def averaged(shots: Mapping[str, Exposed], cells: CellMap) -> tuple[dict[str, Exposed], CellMap]:
    """Shots as a camera with one quad a cell would have taken them, or one with four where cells
    have `pieces`, and the map of that camera.

    Quads that are saturated in any shot do not count, but where too little of a cell is left all
    of it does. Cells that no quad sees are as bright as the mean of the others. There is no
    variance: it is not asked for.

    The light of cells is told from that of their neighbours, where quads see both: the codes err
    differently in both, and a mean of the two would err less than either.
    """
    grid, cells = cells.grid, pieces(cells)
    alike = CellMap.block(grid, grid)
    if cells.grid != grid:
        height, width = cells.grid
        alike = CellMap(grid=grid, frame=cells.grid, map=Map.filling((width, height)))
    lost = np.logical_or.reduce([shot.saturated for shot in shots.values()])
    known = ~lost if lost.any() else None
    unseen = ~cells.seen()
    shape = *cells.grid, 3
    nothing, dark = np.zeros(shape), np.zeros(cells.grid, np.bool_)
    parting = told_parts_apart(cells, known)

    def coarse(shot: Exposed) -> Print:
        whole = _whole(shot.light, cells)
        light, sure = means(whole, known, cells)
        if parting is not None:
            light[sure] = parting.mean(whole)[sure]
        if unseen.any() and not unseen.all():
            light[unseen] = light[~unseen].mean(axis=0)
        return Print(light.reshape(shape), nothing, dark, shot.realised, shot.exif, shot.missed)

    return {name: coarse(shot) for name, shot in shots.items()}, alike


def pieces(cells: CellMap) -> CellMap:
    """The map of what parts are averaged over: of half cells each way where quads are so fine that
    many lie in one, and else of cells.

    Codes are shown through windows of half a cell, and near the edge of a cell a quad sees places
    that are much like those beyond it, through a mask that is not: a mean over the whole cell would
    know nothing of either.
    """
    side = 0.5 * cells.quad_cells**-0.5 if cells.quad_cells else 0.0
    if cells.blocks is not None or side - SMEARED * cells.blur_quads < FINE:
        return cells
    rows, cols = cells.grid
    return msgspec.structs.replace(cells, grid=(2 * rows, 2 * cols))


def told_parts_apart(cells: CellMap, known: Bools | None) -> Apart | None:
    """How cells are told apart in the parts of a photo, of `known` quads (h, w), None for all; None
    where no quad sees two cells, or so few do that it makes no odds."""
    if cells.quad_cells * MANY < 1.0 and cells.quad_cells and not cells.blur_quads:
        return None
    if cells.single[cells.known].all():
        return None
    good = cells.known if known is None else known & cells.known
    return told_apart(good, cells, np.flatnonzero(cells.seen(known)))


def barred_by_parts(
    pictures: Mapping[str, Picture],
    parts: Mapping[str, list[Floats]],
    cells: CellMap,
    alike: Mapping[str, Floats],
) -> dict[str, Barred]:
    """Pictures whose sigma is the sensor's, with the code error that their parts show. It is told
    of cells, and lies on quads as light does.

    parts : of `part_images`. alike : errors of the pictures' cells, (rows, cols, 3) each, that all
    parts share, where there are any.
    """
    found, parted = {}, pieces(cells)
    for name, picture in pictures.items():
        coarse = of_cells(picture, parted)
        seen = _with_noise(picture, coarse, parted)
        code = measured(seen, parts[name]).code
        means_code = None
        if parted.grid != cells.grid:
            fours = [_of_halves(one) for one in parts[name]]
            sigma = np.sqrt(_of_halves(seen.sigma**2) / 4.0)
            whole = Picture(_of_halves(seen.image), sigma)
            means_code = measured(whole, fours).code
        if name in alike:
            times = parted.grid[0] // cells.grid[0]
            code = np.hypot(code, alike[name].repeat(times, axis=0).repeat(times, axis=1))
            if means_code is not None:
                means_code = np.hypot(means_code, alike[name])
        one = barred(picture, shared_out(code, picture, coarse, parted), "measured")
        found[name] = replace(one, of_cells=means_code)
    return found


def _of_halves(image: NDArray[np.floating]) -> Floats:
    """Means over the four pieces of each cell, (2 rows, 2 cols, 3) -> (rows, cols, 3)."""
    rows, cols = image.shape[0] // 2, image.shape[1] // 2
    return np.asarray(image.reshape(rows, 2, cols, 2, -1).mean(axis=(1, 3)), dtype=np.float64)


def _with_noise(picture: Picture, coarse: Picture, cells: CellMap) -> Picture:
    """Means of a picture over cells, (rows, cols, 3), with the error that sensor noise leaves in
    them where cells are told apart as in its parts."""
    known: Bools = np.asarray(np.isfinite(picture.sigma).all(axis=-1))
    parting = told_parts_apart(cells, None if known.all() else known)
    seen = np.flatnonzero(np.isfinite(coarse.sigma).all(axis=-1))
    if parting is None or not seen.size:
        return coarse
    error = parting.error(picture.sigma**2, int(seen[seen.size // 2])).reshape(coarse.sigma.shape)
    return Picture(coarse.image, np.where(np.isfinite(coarse.sigma), error, coarse.sigma))


def _whole(light: Floats, cells: CellMap) -> Floats:
    """Light of quads that see past the border of the field, as if they did not."""
    if cells.inside is None:
        return light
    share = np.where(cells.known & (cells.inside > 0.0), cells.inside, 1.0)
    return np.asarray(light / share[..., None])


def used(recipe: Recipe, shots: Mapping[str, Exposed]) -> dict[str, Exposed]:
    """The shots of a recipe's photos."""
    names = dict.fromkeys(name for photo in recipe.photos for _, name in photo.shots)
    return {name: shots[name] for name in names}
