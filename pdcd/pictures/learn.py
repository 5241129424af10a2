"""What the pilot photos of a run tell of its scene: linked cells, and what to correct for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.codes.pilot.codes import MATCHED, SCOUTS
from pdcd.codes.pilot.links import (
    SHARP,
    Worth,
    correction,
    estimate_links,
    match_links,
    sharpness,
    worth,
)
from pdcd.codes.pilot.scene_light import near_light, sharp_squares
from pdcd.pictures.cell_light import Ambient, Lit, light_of_cells
from pdcd.pictures.exposed import Exposed
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import Wanted
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Paths: TypeAlias = "tuple[scipy.sparse.csr_array, scipy.sparse.csr_array, scipy.sparse.csr_array]"


@dataclass(frozen=True)
class Learned:
    """Paths found by a pilot, or what its scouts saw.

    links : sparse (N, N), of all channels together; paths : the same for R, G, B.
    worth : predicted errors with and without the pilot; if it does not pay, the paths are empty.
        None where only the scouts were taken, which find no paths, and after a short pilot, whose
        scouts alone tell whether it pays.
    sharpness : of the light in the scouts (`pdcd.codes.pilot.links.sharpness`).
    """

    links: scipy.sparse.csr_array
    paths: Paths
    worth: Worth | None
    sharpness: float
    sharp: Floats
    """(N, 3), sum of the squares of the sharp paths of each cell that were not found
    (`pdcd.codes.pilot.scene_light`)."""
    near: Floats
    """(N, 3), light that each cell gets from one of those right beside it, on average
    (`pdcd.codes.pilot.scene_light`)."""

    @property
    def promising(self) -> bool:
        """Whether the scouts saw enough for the pilot to go on."""
        return self.sharpness >= SHARP

    @property
    def pays(self) -> bool:
        """Whether the paths found are worth avoiding."""
        return self.links.nnz > 0 and (self.worth is None or self.worth.pays)


def stack_photos(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    bits: Bools,
    cells: CellMap,
    *,
    ambient: Ambient | None = None,
) -> tuple[Floats, Floats, Floats | None]:
    """Single-code photos in scene units, ``T i_k``, and their standard deviation, (K, N, 3) each.

    Those not taken yet are left out; `bits` are of those that were. Each is divided by its
    own time of open mask and lit projector; quads of a cell are averaged. Light of cells is told
    from that of their neighbours where quads see both: else direct light of a neighbour looks like
    a sharp path from there.

    `ambient` light is taken off for the time for which the mask was open. Its own noise is the same
    in all photos, and no part of their standard deviation: it comes third, as variance (N, 3).
    """
    taken = [shots[name] for name in recipe.stack if name in shots]
    weights = times_s([shot.realised for shot in taken], bits)[:, None, None]
    photos, sigmas = _of_cells(taken, cells)
    if ambient is None:
        return photos / weights, sigmas / weights, None
    (dark,), (dark_sigma,) = _of_cells([ambient], cells)
    opened = np.array([shot.realised.open_s for shot in taken])[:, :, None]
    common = (dark_sigma * np.mean(opened / weights, axis=0)) ** 2
    return (photos - opened * dark) / weights, sigmas / weights, common


def _of_cells(taken: Sequence[Lit], cells: CellMap) -> tuple[Floats, Floats]:
    """Light of all cells in K photos and its standard deviation, (K, N, 3) each."""
    if cells.blocks is not None:  # then no quad sees two
        return (
            np.array([cells.mean(shot.light) for shot in taken]),
            np.array([cells.error_of_mean(shot.variance) for shot in taken]),
        )
    seen, all_known = np.flatnonzero(cells.seen()), np.ones(cells.frame, np.bool_)
    photos, sigmas = np.zeros((2, len(taken), cells.grid[0] * cells.grid[1], 3))
    photos[:, seen], sigmas[:, seen] = light_of_cells(taken, all_known, cells, seen)
    return photos, sigmas


def learn(
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    bits: Bools,
    total: int,
    cells: CellMap,
    *,
    ambient: Ambient | None = None,
) -> Learned:
    """Find the strong far paths in the pilot photos, `total` codes being spent in all.

    ambient : as in `stack_photos`. With the scouts alone among `shots`, only look whether
    there may be any.
    """
    taken = sum(name in shots for name in recipe.stack)
    bits = bits[:taken]
    photos, sigma, common = stack_photos(recipe, shots, bits, cells, ambient=ambient)
    grid = recipe.target.grid
    grey, grey_sigma = photos.mean(axis=2), np.sqrt(np.sum(sigma**2, axis=2)) / 3.0
    first = slice(0, SCOUTS)
    taken_off = None if common is None else np.sum(common, axis=1) / 9.0
    sharp = sharpness(bits[first], grey[first], sigma=grey_sigma[first], taken_off=taken_off)

    def with_paths(
        links: scipy.sparse.csr_array, paths: Paths, predicted: Worth | None = None
    ) -> Learned:
        known = np.stack([(one @ bits.T.astype(np.float64)).T for one in paths], axis=2)
        some = known[first]
        left = sharp_squares(bits[first], photos[first], grid, sigma=sigma[first], paths=some)
        near = near_light(bits, photos - known, grid) + _beside(paths, grid)
        return Learned(links, paths, predicted, sharp, left, near)

    none = scipy.sparse.csr_array((bits.shape[1], bits.shape[1]))
    if taken == SCOUTS:
        return with_paths(none, (none, none, none))
    if taken in MATCHED:
        links, red, green, blue = match_links(bits, photos, grid, sigma=sigma)
        return with_paths(links, (red, green, blue))
    links = estimate_links(bits, grey, grid, sigma=grey_sigma)
    predicted = worth(bits, grey, links, total, sigma=grey_sigma)
    if not predicted.pays:
        return with_paths(none, (none, none, none), predicted)
    if np.array_equal(photos[..., 0], photos[..., 1]):
        return with_paths(links, (links, links, links), predicted)
    red, green, blue = (
        estimate_links(bits, photos[..., c], grid, sigma=sigma[..., c]) for c in range(3)
    )
    return with_paths(links, (red, green, blue), predicted)


def _beside(paths: Paths, grid: tuple[int, int]) -> Floats:
    """Light by known paths from the eight cells around each, the mean of the eight, (N, 3)."""
    found = np.zeros((grid[0] * grid[1], len(paths)))
    for channel, one in enumerate(paths):
        path = one.tocoo()
        (to_row, to_col), (row, col) = (np.divmod(n, grid[1]) for n in path.coords)
        near = (np.abs(to_row - row) <= 1) & (np.abs(to_col - col) <= 1)
        near &= (to_row != row) | (to_col != col)
        np.add.at(found[:, channel], path.coords[0][near], np.maximum(path.data[near], 0.0) / 8.0)
    return found


def corrections(
    learned: Learned, realised: Factors, weight_s: float | Floats, wanted: Wanted
) -> Floats:
    """What to add to a picture of what is wanted for the paths found, (N, 3), in scene units.

    weight_s : what the picture was divided by, of all cells or (N,).
    """
    left, right = realised.left, realised.right
    return np.stack(
        [correction(left, right, weight_s, p, _kept(wanted, p)) for p in learned.paths], axis=1
    )


def known_light(learned: Learned, wanted: Wanted) -> Floats:
    """Light by the paths found in a picture of what is wanted, (N, 3), in scene units."""
    light = np.zeros((wanted.cells, len(learned.paths)))
    for channel, one in enumerate(learned.paths):
        table = one.tocoo()
        np.add.at(light[:, channel], table.coords[0], _kept(wanted, one) * table.data)
    return light


def _kept(wanted: Wanted, paths: scipy.sparse.csr_array) -> Floats:
    """Wanted weight of each path, in the order of their entries."""
    row, column = paths.tocoo().coords
    return wanted.pairs(row.astype(np.int64), column.astype(np.int64))


def times_s(realised: Sequence[Factors], bits: Bools) -> Floats:
    """`time_s` of several photos, (K,), by their codes (K, N). Codes that light no cell, as there
    are on grids of a few cells, are taken to be shown as long as the others on average."""
    times: Floats = np.array([time_s(*one) for one in zip(realised, bits, strict=True)])
    lit = bits.any(axis=1)
    if lit.any():
        times[~lit] = times[lit].mean()
    return times


def time_s(realised: Factors, lit: Bools) -> float:
    """Least-squares time for which the lit cells shone and the mask was open."""
    seen = realised.left.sum(axis=1)
    shone = realised.right @ lit.astype(np.float64)
    return float(np.sum(seen * shone)) / (lit.size * max(int(lit.sum()), 1))
