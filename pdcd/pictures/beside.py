"""The error of a photo by light from right beside each cell, which no spread of parts shows.

Windows of parts of a cell take some of this light for direct light, and some of the cell's own for
indirect light (`pdcd.pictures.sigma.compute_neighbour_weight`). A pilot measures how much of it
there is. Where quads get it by few paths, as in rough stone, it varies from quad to quad.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pdcd.arrays import Floats
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.learn import PilotFindings
from pdcd.pictures.picture import Errors, Picture
from pdcd.pictures.quad_samples import QuadSample, sample_quads
from pdcd.pictures.smooth import HALF_LIGHT_CELLS
from pdcd.pictures.to_cells import average_picture
from pdcd.pictures.to_quads import spread_errors
from pdcd.pictures.weights import CellWeights
from pdcd.probing.deviation import compute_row_deviations
from pdcd.sensor.cells import CellMap

USUAL = 0.02
"""Light from one of the eight cells around, over all indirect light, where no pilot measured it:
between the virtual scenes with little of it (0.1 to 1 %) and those with much (2 to 7 %)."""
_UNEVEN = 1.3
"""Root of the mean square of the light from the eight cells around, over its mean: 1.05 to 2.5 in
the virtual scenes."""
_COUNTED = 2
"""Distance in cells up to which the codes of all parts count light alike, as they separate it."""
_OF_WINDOWS = (5 / 8) ** 2 + 3 * (1 / 8) ** 2
"""Along an axis, variance of weights between cells over that between quarter windows: five eighths
of the light pass between two code cells, and an eighth between each of three other pairs."""
_AROUND = 9
"""Side, in cells, of the square over which single paths of light are averaged."""
_LEAST_TOLD = 1e-6
"""Share of the codes' total power below which the power at a cell is rounding error."""
_FEWEST_SHOTS = 4
"""Least number of single-code photos to estimate from, after room and direct light are removed."""


@dataclass(frozen=True, eq=False)
class NeighbourError:
    """Standard deviation of a photo because of light from right beside its cells: of means over
    cells, (rows, cols, C), and of quads, (h, w, C)."""

    even: Floats
    of_quads: Errors


def estimate_neighbour_errors(
    weighed: Sequence[tuple[CellWeights, float]],
    photos: Mapping[str, Picture],
    single: Sequence[ExposedShot],
    by_codes: Mapping[str, Floats],
    learned: PilotFindings | None,
    cells: CellMap,
) -> dict[str, NeighbourError]:
    """The error, by name, of photos that cannot separate light from right beside a cell from direct
    light; for `pdcd.pictures.bars`.

    Of the light that reaches single quads by paths of their own, the spread of the parts measures
    how much comes from afar, as codes count only that by chance. The rest comes from near, and is
    taken to fall with distance as smooth light does (`pdcd.pictures.smooth`). Such a path is
    counted in full or not at all. So its variance grows with the share of light that is mistaken
    where a quad looks; the variance of even light grows with the square of that share.

    weighed : photos that have a `pdcd.pictures.sigma.compute_neighbour_weight`, each with it.
    photos : scaled ones. single : photos of single codes. by_codes : errors of single quads by
    codes, on cells or halves (`pdcd.pictures.sigma.to_quad_errors`). learned : of a pilot, if any.
    """
    found, picked = {}, sample_quads(single, cells, within=True)
    ways = estimate_quad_paths(single, picked, learned)
    for weights, weight in weighed:
        name = weights.photo.name
        photo = photos[name]
        seen = average_picture(photo, cells).image
        light = np.maximum(cells.mean(photo.image), 0.0)
        near = USUAL * light
        if learned is not None and learned.near.any():
            near = learned.near
        even = (_UNEVEN * weight * near).reshape(seen.shape)
        by_chance = np.zeros_like(near)
        if name in by_codes:
            _, variance, _ = compute_row_deviations(
                weights.realised, weights.photo.wanted, float(np.mean(weights.cells_s))
            )
            far = _mean_square(by_codes[name], cells.grid) * _OF_WINDOWS**2 / variance.mean()
            rest = np.maximum(ways - picked.around(far, _AROUND), 0.0)
            by_chance = np.sqrt(np.sqrt(0.5) * weight * _share_mistaken() * rest)
        # Where chance has taken light away, a quad is darker than its error would suggest.
        image = scipy.ndimage.uniform_filter(photo.image, (3, 3, 1), mode="nearest")
        usual = Picture(image, photo.sigma)
        chance = spread_errors(by_chance.reshape(seen.shape), usual, seen, cells)
        places = map_neighbour_light(weights, cells)[..., None]
        of_quads = np.hypot(
            places * spread_errors(even, photo, seen, cells), np.sqrt(places) * chance
        )
        found[name] = NeighbourError(even, of_quads)
    return found


def _mean_square(errors: Floats, grid: tuple[int, int]) -> Floats:
    """Mean squares over cells, (N, C), of errors of cells or of parts of them."""
    rows, cols = grid
    shape = rows, errors.shape[0] // rows, cols, errors.shape[1] // cols, -1
    return np.asarray((errors**2).reshape(shape).mean(axis=(1, 3)).reshape(rows * cols, -1))


def _share_mistaken() -> float:
    """Light from one of the eight cells around plus that from the cell itself, over all near light
    except the cell's own."""
    side = np.arange(-_COUNTED, _COUNTED + 1)
    light = 1.0 / (1.0 + (side[:, None] ** 2 + side**2) / HALF_LIGHT_CELLS**2)
    beside = light[_COUNTED - 1 : _COUNTED + 2, _COUNTED - 1 : _COUNTED + 2].sum() - 1.0
    return float((beside / 8.0 + 1.0) / (light.sum() - 1.0))


def map_neighbour_light(weights: CellWeights, cells: CellMap) -> Floats:
    """Share of light that is mistaken where each quad looks, over its mean over a cell, (h, w); ()
    where the camera cannot resolve parts of cells.

    Under quarter windows nothing is mistaken in the middle of a cell, half of a cell's light at its
    edges and three quarters at its corners. The map is an average over all cells, so that the
    chance of codes does not count.
    """
    fine, uniform = weights.realised.fine, weights.photo.wanted.uniform
    if fine is None or cells.map is None or uniform is None:
        return np.ones(())
    down, right = (np.diff(cut) for cut in fine.cuts)
    own_s = fine.own.reshape(cells.grid[0], down.size, cells.grid[1], right.size).mean(axis=(0, 2))
    mistaken = np.abs(own_s / float(np.mean(weights.cells_s)) - uniform[0])
    mistaken /= float(down @ mistaken @ right)
    return cells.gather(np.tile(mistaken, cells.grid), fine.cuts)


def estimate_quad_paths(
    shots: Sequence[ExposedShot], picked: QuadSample, learned: PilotFindings | None = None
) -> Floats:
    """How grainy indirect light is within a cell: the squared light of each single path to a quad,
    summed over all paths, (N, C). Zeros, (N, 1), where it cannot be estimated.

    It is estimated from photos of single codes through an open mask, each of which is a sum of the
    light of all lit cells. Smooth light changes little between neighbouring quads, so that their
    difference is light of their own paths. Direct light follows the code of the cell and drops out.
    The paths that a pilot has `learned` are subtracted.

    shots : photos of single codes; the codes of two cells differ. picked : some quads.
    """
    grid = picked.grid
    if len(shots) < _FEWEST_SHOTS or not picked.pairs.size:
        return np.zeros((grid[0] * grid[1], 1))
    lit_s = np.stack([shot.realised.left.mean(axis=1) @ shot.realised.right for shot in shots])
    opened = np.array([float(shot.realised.open_s.mean()) for shot in shots])
    room = opened / np.linalg.norm(opened)
    own = lit_s - np.outer(room, room @ lit_s)
    power = np.linalg.norm(own, axis=0)
    own = np.divide(own, power, out=np.zeros_like(own), where=power > 0.0)
    mixed = lit_s @ lit_s.T / lit_s.shape[1]
    each = np.trace(mixed) - room @ mixed @ room - np.einsum("kn,kl,ln->n", own, mixed, own)
    here, there = picked.pairs
    cell = picked.cell[here]
    light = np.stack([picked.take(shot.light_at) for shot in shots])
    noise = np.stack([picked.take(shot.variance_at) for shot in shots])
    apart = (light[:, here] - light[:, there]) / np.sqrt(2.0)
    spare = 1.0 - room[:, None] ** 2 - own[:, cell] ** 2
    square = np.sum(apart**2, axis=0) - np.tensordot(room, apart, 1) ** 2
    square -= np.einsum("kq,kqc->qc", own[:, cell], apart) ** 2
    square -= 0.5 * np.einsum("kq,kqc->qc", spare, noise[:, here] + noise[:, there])
    weight = picked.of_pairs(each[cell, None], cell, _AROUND)
    told = picked.of_pairs(square, cell, _AROUND)
    sure = weight > _LEAST_TOLD * np.trace(mixed)
    if not sure.any():
        return np.zeros_like(told)
    found = np.broadcast_to(told.sum(axis=0) / weight.sum(axis=0), told.shape).copy()
    np.divide(told, weight, out=found, where=sure)  # elsewhere the mean of these stays
    if learned is not None:  # known paths, as by mirrors, are not part of the grain
        known = np.stack([one.multiply(one).sum(axis=1) for one in learned.paths], axis=1)
        found -= picked.around(known, _AROUND)
    return np.asarray(np.maximum(found, 0.0))
