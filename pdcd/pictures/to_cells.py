"""From the quads of a camera down to cells: means over each cell, and which cells are known.

This is the one way down, as `pdcd.pictures.to_quads` is the one way up. What is computed from these
means needs no map of the camera.

A mean over a cell's area holds light of its neighbours wherever quads lie across its borders: a
part that is small where a cell has many quads, and a third where it has three a side. Where that
matters the light of cells is separated (`_Apart`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats, Indices
from pdcd.panels.map import Map
from pdcd.pictures.exposed import ComputedShot, ExposedShot, FrameLight
from pdcd.pictures.picture import Picture, PictureWithErrors
from pdcd.sensor.cells import CellMap

_LEAST_PURE = 0.05
"""Share of a cell's area that must be covered by quads that see nothing else, for these alone to be
used: if all quads are used, texture at the edges of cells looks like light from next to them."""
_LEAST_WHOLE = 0.2
"""The same where the mean is to stand for the whole cell, or half of one."""
_AMID_QUADS = 2.5
"""Distance from the edges of a cell, in quads, from which quads see that cell alone where cells are
fine enough: the blur of a lens may not have been declared, and direct light of the next cell looks
like indirect light from there."""
_STEPS = 12
"""Iterations: they separate half a cell from its neighbours to a thousandth."""
_FINE = 1.6
"""Quads along a side of half a cell, beyond what a blur smears, from which parts are averaged over
halves: of fewer, too few see one half alone."""
_COARSE = 1.45
"""The same where each half is seen by some quads that see nothing else, as with upright quads,
three a cell."""
_MANY = 400
"""Quads in a cell, or in half of one, from which those across a border do not matter: they lessen
the error by codes by 1 % or less."""
SMEARED = 3.0
"""Standard deviations of a blur that count as smeared."""


@dataclass(frozen=True, eq=False)
class CellLight:
    """Light of cells and its standard deviation by the sensor: (N, C) each, or (K, N, C) of K
    shots."""

    light: Floats
    error: Floats


def find_seen_cells(cells: CellMap) -> Bools | None:
    """Cells that any quad sees, (N,); None for all."""
    seen = cells.seen()
    return None if seen.all() else seen


def average_shot(shot: FrameLight, cells: CellMap) -> CellLight:
    """Means of a shot over cells, from all quads, also those that see neighbours."""
    return CellLight(cells.mean(shot.light), cells.error_of_mean(shot.variance))


def average_picture(picture: Picture, cells: CellMap) -> Picture:
    """Means of a picture over cells, (rows, cols, C) float64, and the error of these means from
    that of single quads; infinite where too little of a cell is known.

    Unknown quads do not count. An unknown cell has the mean of all quads that see it, as they were
    measured. Cells that no quad sees are 0.
    """
    known = _known(picture, cells)
    image, sure = _means(picture.image, known, cells)
    sigma = cells.error_of_mean(picture.sigma**2, known)
    sigma[~sure] = np.inf
    shape = *cells.grid, image.shape[1]
    return Picture(image.reshape(shape), sigma.reshape(shape))


def average_light(picture: Picture, cells: CellMap) -> Floats:
    """The image of `average_picture` alone, in half the time."""
    image, _ = _means(picture.image, _known(picture, cells), cells)
    return image.reshape(*cells.grid, -1)


def average_with_errors(
    picture: PictureWithErrors, cells: CellMap, full: Bools | None = None
) -> PictureWithErrors:
    """The same of a picture with its whole error: (rows, cols, C) float64 each.

    Averaging lessens the sensor's part of the error. It does not lessen the error of the codes,
    which the quads of a cell share, except as `PictureWithErrors.of_cells` says.

    full : (h, w), quads that light has saturated (`pdcd.pictures.full`), None for none. A cell with
    one is unknown: the mean of the others is too dark by the light beyond saturation.
    """
    coarse = average_picture(Picture(picture.image, picture.sensor), cells)
    if full is not None:
        over = cells.touched(full)
        coarse.sigma.reshape(over.size, -1)[over] = np.inf
        means = cells.mean(picture.image)
        coarse.image.reshape(over.size, -1)[over] = means[over]
    code = picture.of_cells
    if code is None:
        code, _ = _means(picture.code, _known(picture, cells), cells)
        code = code.reshape(coarse.image.shape)
    sigma = np.hypot(coarse.sigma, code)
    return PictureWithErrors(coarse.image, sigma, coarse.sigma, code, picture.kind)


def average_unmixed(picture: Picture, cells: CellMap) -> Picture:
    """Means of a picture over cells as of `average_picture`. The error is the sensor noise that is
    left in them where cells are separated as in the parts of the picture (`average_shots`)."""
    coarse = average_picture(picture, cells)
    known: Bools = np.asarray(np.isfinite(picture.sigma).all(axis=-1))
    parting = _part_neighbours(cells, None if known.all() else known)
    seen = np.flatnonzero(np.isfinite(coarse.sigma).all(axis=-1))
    if parting is None or not seen.size:
        return coarse
    error = parting.error(picture.sigma**2, int(seen[seen.size // 2])).reshape(coarse.sigma.shape)
    return Picture(coarse.image, np.where(np.isfinite(coarse.sigma), error, coarse.sigma))


def average_part(picture: Picture, cells: CellMap) -> Floats:
    """Means of a picture over cells, separated as in `average_shots`, (rows, cols, C); 0 for cells
    that no quad sees."""
    known = _known(picture, cells)
    image, sure = _means(picture.image, known, cells)
    parting = _part_neighbours(cells, known)
    if parting is not None:
        image[sure] = parting.mean(picture.image)[sure]
    image[~cells.seen()] = 0.0
    return image.reshape(*cells.grid, -1)


def _means(
    image: NDArray[np.floating], known: Bools | None, cells: CellMap
) -> tuple[Floats, Bools]:
    """Means of an image (h, w, C) over cells, (N, C), and which cells are known (N,).

    known : (h, w), quads that count, unless too little of a cell is left; None for all of the
    field.
    """
    sure = cells.seen(known)
    mean = cells.mean(image, known)
    if not sure.all():
        mean[~sure] = cells.mean(image)[~sure]
    return mean, sure


def _known(picture: Picture, cells: CellMap) -> Bools | None:
    """(h, w), quads known in all channels; None where these are all that the field has."""
    known = np.isfinite(picture.sigma[..., 0])
    for channel in range(1, picture.sigma.shape[2]):
        known &= np.isfinite(picture.sigma[..., channel])
    return None if np.array_equal(known, cells.known) else known


@dataclass(frozen=True, eq=False)
class _Apart:
    """How cells are separated: which quads count (h, w), and whether their mixtures are solved."""

    cells: CellMap
    known: Bools
    used: Bools
    pure: bool

    def mean(self, light: Floats) -> Floats:
        """Light of quads (h, w, C) -> of cells (N, C)."""
        mean = self.cells.mean(light, self.used)
        return mean if self.pure else _part(mean, self.cells, self.known)

    def error(self, variance: NDArray[np.floating], middle: int) -> Floats:
        """Variances of quads (h, w, C) -> standard deviation of `mean`, (N, C). Where mixtures are
        solved, noise is taken to grow everywhere as much as at the cell `middle`."""
        error = self.cells.error_of_mean(variance, self.used)
        if self.pure:
            return error
        one = np.zeros((self.cells.grid[0] * self.cells.grid[1], 1))
        one[middle] = 1.0
        more = float(np.sqrt(np.sum(_part(one, self.cells, self.known) ** 2)))
        return more * error


def _tell_apart(
    known: Bools, cells: CellMap, wanted: Indices, least: float = _LEAST_PURE
) -> _Apart:
    """How to separate the light of some cells from that of their neighbours.

    By quads amid a cell, or at least by those that see one alone, where each cell has enough of
    them. Else all quads count, and their mixtures are solved as if each cell had one value.

    known : (h, w), quads that count. wanted : (C,), numbers of the cells. least : share of a cell
    that is enough.
    """
    alone = known & cells.single
    for used in (alone & find_inner_quads(cells), alone):
        share = cells.mean(used[..., None].astype(np.float64))[wanted]
        if share.min(initial=1.0) >= least:
            return _Apart(cells, known, used, pure=True)
    return _Apart(cells, known, known, pure=False)


def find_inner_quads(cells: CellMap) -> Bools:
    """(h, w), quads that see one cell alone even by an unknown blur; none where cells have few."""
    if _AMID_QUADS * cells.quad_cells**0.5 >= 0.5 or not cells.quad_cells:
        return np.zeros(cells.frame, np.bool_)
    return cells.amid(_AMID_QUADS)


def unmix_some_cells(
    taken: Sequence[FrameLight],
    known: Bools,
    cells: CellMap,
    wanted: Indices,
    least: float = _LEAST_WHOLE,
) -> CellLight:
    """Light of some cells in K photos, (K, M, C), separated from that of their neighbours.

    known : (h, w), quads that count. wanted : (M,), numbers of the cells.
    """
    apart = _tell_apart(known, cells, wanted, least)
    light = [apart.mean(shot.light)[wanted] for shot in taken]
    middle = int(wanted[wanted.size // 2])
    error = [apart.error(shot.variance, middle)[wanted] for shot in taken]
    return CellLight(np.stack(light), np.stack(error))


def unmix_cells(taken: Sequence[FrameLight], cells: CellMap) -> CellLight:
    """Light of all cells in K photos, (K, N, C), separated from that of their neighbours where
    quads see both: else direct light of a neighbour looks like a sharp path from there."""
    if cells.blocks is not None:  # then no quad sees two
        light = np.array([cells.mean(shot.light) for shot in taken])
        return CellLight(light, np.array([cells.error_of_mean(shot.variance) for shot in taken]))
    seen, all_known = np.flatnonzero(cells.seen()), np.ones(cells.frame, np.bool_)
    found = unmix_some_cells(taken, all_known, cells, seen, _LEAST_PURE)
    shape = len(taken), cells.grid[0] * cells.grid[1], found.light.shape[2]
    photos, sigmas = np.zeros(shape), np.zeros(shape)
    photos[:, seen], sigmas[:, seen] = found.light, found.error
    return CellLight(photos, sigmas)


def _part(means: Floats, cells: CellMap, known: Bools) -> Floats:
    """Means over cells (N, C) of quads that mix cells -> values of cells, by Van Cittert's method:
    what cells of these values would look like is compared with what was seen, again and again."""
    values = means.copy()
    for _ in range(_STEPS):
        values += means - cells.mean(cells.spread(values), known)
    return values


@dataclass(frozen=True, eq=False)
class AveragedShots:
    """Shots as a camera with one quad a cell would have taken them, or one with four.

    shots : of that camera, without variance. cells : its map. unseen : its quads, counted row by
    row, that the real camera does not see. unknown : these, and those of which too little is
    unsaturated.
    """

    shots: Mapping[str, ExposedShot]
    cells: CellMap
    unseen: Indices
    unknown: Indices


def average_shots(
    shots: Mapping[str, ExposedShot], cells: CellMap, *, all_quads: bool = False
) -> AveragedShots:
    """Shots as a camera with one quad a cell would have taken them, or one with four where cells
    are halved (`choose_part_cells`).

    Quads that are saturated in any shot do not count, unless too little of a cell is left: then all
    of its quads do. Cells that no quad sees are as bright as the mean of the others. There is no
    variance, as nobody needs it.

    The light of cells is separated from that of their neighbours, where quads see both: their
    errors by codes differ, and a mean of the two would have less error than either.

    all_quads : average over whole cells where averages over halves would leave out many quads
    (`are_all_quads_used`).
    """
    grid, cells = (
        cells.grid,
        cells if all_quads and not are_all_quads_used(cells) else choose_part_cells(cells),
    )
    alike = CellMap.block(grid, grid)
    if cells.grid != grid:
        height, width = cells.grid
        alike = CellMap(grid=grid, frame=cells.grid, map=Map.filling((width, height)))
    lost = np.logical_or.reduce([shot.saturated for shot in shots.values()])
    known = ~lost if lost.any() else None
    unseen = ~cells.seen()
    dark = np.zeros(cells.grid, np.bool_)
    parting = _part_neighbours(cells, known)

    def coarse(shot: ExposedShot) -> ComputedShot:
        whole = _whole(shot.light, cells)
        light, sure = _means(whole, known, cells)
        if parting is not None:
            light[sure] = parting.mean(whole)[sure]
        if unseen.any() and not unseen.all():
            light[unseen] = light[~unseen].mean(axis=0)
        light = light.reshape(*cells.grid, light.shape[1])
        nothing = np.zeros_like(light)
        return ComputedShot(light, nothing, dark, shot.realised, shot.exif, shot.missed)

    averaged = {name: coarse(shot) for name, shot in shots.items()}
    return AveragedShots(
        averaged, alike, np.flatnonzero(unseen), np.flatnonzero(~cells.seen(known))
    )


def choose_part_cells(cells: CellMap) -> CellMap:
    """The map of what parts are averaged over: half cells each way where quads are so fine that
    many lie in one, and else cells.

    Codes are shown through windows of half a cell. Near the edge of a cell a quad sees places much
    like those beyond the edge, but through another part of the mask. A mean over the whole cell
    would show neither.
    """
    if cells.blocks is not None or _half_side(cells) < _COARSE:
        return cells
    rows, cols = cells.grid
    halves = msgspec.structs.replace(cells, grid=(2 * rows, 2 * cols))
    if _half_side(cells) < _FINE:
        alone = (halves.known & halves.single)[..., None].astype(np.float64)
        seen = halves.mean(alone)[halves.seen()]
        if seen.min(initial=1.0) < _LEAST_WHOLE:
            return cells
    return halves


def are_all_quads_used(cells: CellMap) -> bool:
    """Whether averages over half cells use all quads. With few quads they leave out those in the
    middle of a cell: five of nine where there are three a side."""
    return cells.blocks is not None or not _COARSE <= _half_side(cells) < _FINE


def _half_side(cells: CellMap) -> float:
    """Quads along a side of half a cell, beyond what a blur smears."""
    side = 0.5 * cells.quad_cells**-0.5 if cells.quad_cells else 0.0
    return side - SMEARED * cells.blur_quads


def _part_neighbours(cells: CellMap, known: Bools | None) -> _Apart | None:
    """How to separate cells in the parts of a photo, by `known` quads (h, w), None for all; None
    where no quad sees two cells, or so few do that it does not matter."""
    if cells.quad_cells * _MANY < 1.0 and cells.quad_cells and not cells.blur_quads:
        return None
    if cells.single[cells.known].all():
        return None
    good = cells.known if known is None else known & cells.known
    return _tell_apart(good, cells, np.flatnonzero(cells.seen(known)))


def _whole(light: Floats, cells: CellMap) -> Floats:
    """Light of quads across the border of the field, scaled up as if they lay wholly inside."""
    if cells.inside is None:
        return light
    share = np.where(cells.known & (cells.inside > 0.0), cells.inside, 1.0)
    return np.asarray(light / share[..., None])
