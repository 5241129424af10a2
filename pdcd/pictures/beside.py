"""Light from right beside each cell, which no spread of parts shows: how wrong it makes a photo.

Windows of parts of a cell take some of it for direct light, and some of the cell's own for indirect
(`pdcd.pictures.sigma.compute_neighbour_weight`). How much light that is, a pilot tells; where quads
get theirs by few ways, as in rough stone, chance makes it more in one and less in the next.
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
from pdcd.pictures.to_cells import average_image, average_picture
from pdcd.pictures.to_quads import spread_errors
from pdcd.pictures.weights import CellWeights
from pdcd.probing.deviation import compute_row_deviations
from pdcd.sensor.cells import CellMap

USUAL = 0.02
"""Light from one of the eight cells around, over all indirect light, where no pilot tells: between
the virtual scenes with little of it (0.1 to 1 %) and those with much (2 to 7 %)."""
_UNEVEN = 1.3
"""Root of the mean square of what the eight send, over its mean: 1.05 to 2.5 before the virtual
scenes."""
_COUNTED = 2
"""Cells away up to which the codes of parts count all light alike: they are told apart."""
_OF_WINDOWS = (5 / 8) ** 2 + 3 * (1 / 8) ** 2
"""Along an axis, variance of weights between cells over that between quarter windows: five eighths
of it all is between two code cells, and an eighth between each of three others."""
_AROUND = 9
"""Side, in cells, of the square over which ways of light are told."""
_LEAST_TOLD = 1e-6
"""Share of what photos differ by below which that is rounding."""
_FEWEST_SHOTS = 4
"""Photos of single codes that tell anything, room light and direct light taken off."""


@dataclass(frozen=True, eq=False)
class NeighbourError:
    """Standard deviation of a photo by light from right beside its cells: of means over cells,
    (rows, cols, C), and of quads, (h, w, C)."""

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
    """The error of photos that cannot tell light from right beside a cell from direct light, by
    name; for `pdcd.pictures.bars`.

    Of light that comes by ways of its own to single quads, the parts of a photo tell how much is
    from afar: that alone their codes count by chance. The rest is from near, and falls with
    distance as smooth light is taken to (`pdcd.pictures.smooth`). Each such way is there as a whole
    or not at all, so that its variance goes with how much is mistaken where a quad looks; that of
    even light goes with the square.

    weighed : photos that have a `pdcd.pictures.sigma.compute_neighbour_weight`, and that. photos :
    scaled ones. single : photos of single codes. by_codes : what single quads of photos err by
    codes, of cells or halves (`pdcd.pictures.sigma.to_quad_errors`). learned : of a pilot, if
    any.
    """
    found, picked = {}, sample_quads(single, cells, within=True)
    ways = estimate_quad_paths(single, picked, learned)
    for weights, weight in weighed:
        name = weights.photo.name
        photo = photos[name]
        seen = average_picture(photo, cells).image
        light = np.maximum(average_image(photo.image, cells), 0.0)
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
        # Where chance has taken light away a quad is darker than its error tells.
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
    """Light from one of the eight cells around and from the cell itself, over all light from near
    but that."""
    side = np.arange(-_COUNTED, _COUNTED + 1)
    light = 1.0 / (1.0 + (side[:, None] ** 2 + side**2) / HALF_LIGHT_CELLS**2)
    beside = light[_COUNTED - 1 : _COUNTED + 2, _COUNTED - 1 : _COUNTED + 2].sum() - 1.0
    return float((beside / 8.0 + 1.0) / (light.sum() - 1.0))


def map_neighbour_light(weights: CellWeights, cells: CellMap) -> Floats:
    """How much light is mistaken where a quad looks, over the mean of all, (h, w); () where the
    camera does not tell pieces of cells.

    Under quarter windows nothing is mistaken in the middle of a cell, half of a cell's light at its
    edges and three quarters at its corners. It is the mean of all cells, so that the chance of
    codes does not count.
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
    """Squares of the light that single quads get along each way by itself, summed over all ways,
    (N, C): how grainy indirect light is within a cell. 0, (N, 1), where nothing tells.

    Photos of single codes through an open mask tell it: each is a sum of the light of all lit
    cells. Between quads that lie beside each other light of one kind changes little, and what is
    left of their difference is theirs alone. Direct light goes along with the code of the cell, and
    drops out, and the paths that a pilot `learned` are taken off.

    shots : photos of single codes, one cell's code unlike another's. picked : some quads.
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
    np.divide(told, weight, out=found, where=sure)  # elsewhere it is as in these
    if learned is not None:  # known paths, as by mirrors, are none of those that wander
        known = np.stack([one.multiply(one).sum(axis=1) for one in learned.paths], axis=1)
        found -= picked.around(known, _AROUND)
    return np.asarray(np.maximum(found, 0.0))
