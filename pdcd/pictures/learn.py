"""What the pilot photos of a run show of its scene: linked cells, and corrections for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats
from pdcd.codes.pilot.codes import MATCHED, SCOUTS
from pdcd.codes.pilot.links import (
    SHARP,
    PilotPrediction,
    compute_path_correction,
    estimate_links,
    estimate_sharpness,
    match_links,
    predict_pilot_errors,
    widen_links,
)
from pdcd.codes.pilot.scene_light import estimate_adjacent_light
from pdcd.pictures.to_cells import CellLight
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import WantedMatrix

_Links: TypeAlias = "scipy.sparse.csr_array"
"""By a name of its own: Python 3.15 looks up the types of fields, and would load scipy.sparse."""
_Paths: TypeAlias = "tuple[_Links, ...]"


@dataclass(frozen=True)
class PilotFindings:
    """Paths found by a pilot, or what its scouts saw.

    links : sparse (N, N), of all channels together. paths : the same for each of C channels.
    worth : predicted errors with and without the pilot; if it does not pay, the paths are empty.
        None where only the scouts were taken, which find no paths, and after a short pilot, where
        the scouts alone decide whether it pays.
    sharpness : of the light in the scouts (`pdcd.codes.pilot.links.estimate_sharpness`).
    """

    links: _Links
    paths: _Paths
    worth: PilotPrediction | None
    sharpness: float
    near: Floats
    """(N, C), light that each cell gets from one of those right beside it, on average
    (`pdcd.codes.pilot.scene_light`)."""

    @property
    def promising(self) -> bool:
        """Whether the scouts saw enough for the pilot to go on."""
        return self.sharpness >= SHARP

    @property
    def pays(self) -> bool:
        """Whether the paths found are worth avoiding."""
        return self.links.nnz > 0 and (self.worth is None or self.worth.pays)


def scale_code_photos(
    taken: Sequence[Factors],
    bits: Bools,
    seen: CellLight,
    ambient: CellLight | None = None,
) -> tuple[Floats, Floats, Floats | None]:
    """Single-code photos in scene units, ``T i_k``, and their standard deviation, (K, N, C) each.

    taken : what the panels did in each of K photos. bits : (K, N), their codes. seen : light of
    their cells (`pdcd.pictures.to_cells.unmix_cells`). Each photo is divided by the time for which
    its mask was open and the projector lit.

    `ambient` light, from one dark photo, is subtracted for the time for which the mask was open.
    Its own noise is the same in all photos, so it is no part of their standard deviation: its
    variance, (N, C), is returned third.
    """
    weights = code_times_s(taken, bits)[:, None, None]
    photos, sigmas = seen.light, seen.error
    if ambient is None:
        return photos / weights, sigmas / weights, None
    (dark,), (dark_sigma,) = ambient.light, ambient.error
    opened = np.array([realised.open_s for realised in taken])[:, :, None]
    common = (dark_sigma * np.mean(opened / weights, axis=0)) ** 2
    return (photos - opened * dark) / weights, sigmas / weights, common


def learn_paths(
    grid: tuple[int, int],
    taken: Sequence[Factors],
    bits: Bools,
    total: int,
    seen: CellLight,
    ambient: CellLight | None = None,
) -> PilotFindings:
    """Find the strong far paths in the pilot photos of a run that will use `total` codes in all.

    Others as of `scale_code_photos`; `bits` may include photos still to come. With the scouts
    alone, only estimate whether there may be any.
    """
    bits = bits[: len(taken)]
    photos, sigma, common = scale_code_photos(taken, bits, seen, ambient)
    colours = photos.shape[2]
    grey, grey_sigma = photos.mean(axis=2), np.sqrt(np.sum(sigma**2, axis=2)) / colours
    first = slice(0, SCOUTS)
    taken_off = None if common is None else np.sum(common, axis=1) / colours**2
    sharp = estimate_sharpness(
        bits[first], grey[first], sigma=grey_sigma[first], taken_off=taken_off
    )

    def with_paths(
        links: scipy.sparse.csr_array, paths: _Paths, predicted: PilotPrediction | None = None
    ) -> PilotFindings:
        known = np.stack([(one @ bits.T.astype(np.float64)).T for one in paths], axis=2)
        near = estimate_adjacent_light(bits, photos - known, grid) + _beside(paths, grid)
        return PilotFindings(links, paths, predicted, sharp, near)

    none = scipy.sparse.csr_array((bits.shape[1], bits.shape[1]))
    if len(taken) == SCOUTS:
        return with_paths(none, (none,) * colours)
    if len(taken) in MATCHED:
        links, *each = match_links(bits, photos, grid, sigma=sigma)
        return with_paths(widen_links(links, grid), tuple(each))
    links = estimate_links(bits, grey, grid, sigma=grey_sigma)
    predicted = predict_pilot_errors(bits, grey, links, total, sigma=grey_sigma)
    if not predicted.pays:
        return with_paths(none, (none,) * colours, predicted)
    if np.array_equal(photos[..., 0], photos[..., -1]):
        return with_paths(links, (links,) * colours, predicted)
    of_each = tuple(
        estimate_links(bits, photos[..., c], grid, sigma=sigma[..., c]) for c in range(colours)
    )
    return with_paths(links, of_each, predicted)


def _beside(paths: _Paths, grid: tuple[int, int]) -> Floats:
    """Light by known paths from the eight cells around each, the mean of the eight, (N, C)."""
    found = np.zeros((grid[0] * grid[1], len(paths)))
    for channel, one in enumerate(paths):
        path = one.tocoo()
        (to_row, to_col), (row, col) = (np.divmod(n, grid[1]) for n in path.coords)
        near = (np.abs(to_row - row) <= 1) & (np.abs(to_col - col) <= 1)
        near &= (to_row != row) | (to_col != col)
        np.add.at(found[:, channel], path.coords[0][near], np.maximum(path.data[near], 0.0) / 8.0)
    return found


def compute_path_corrections(
    learned: PilotFindings, realised: Factors, weight_s: float | Floats, wanted: WantedMatrix
) -> Floats:
    """What to add to a picture of what is wanted, as its codes miscount the paths found, (N, C), in
    scene units.

    weight_s : what the picture was divided by, for all cells or (N,).
    """
    left, right = realised.left, realised.right
    return np.stack(
        [
            compute_path_correction(left, right, weight_s, p, _kept(wanted, p))
            for p in learned.paths
        ],
        axis=1,
    )


def compute_path_light(learned: PilotFindings, wanted: WantedMatrix) -> Floats:
    """Light by the paths found in a picture of what is wanted, (N, C), in scene units."""
    light = np.zeros((wanted.cells, len(learned.paths)))
    for channel, one in enumerate(learned.paths):
        table = one.tocoo()
        np.add.at(light[:, channel], table.coords[0], _kept(wanted, one) * table.data)
    return light


def _kept(wanted: WantedMatrix, paths: scipy.sparse.csr_array) -> Floats:
    """Wanted weight of each path, in the order of their entries."""
    row, column = paths.tocoo().coords
    return wanted.pairs(row.astype(np.int64), column.astype(np.int64))


def code_times_s(realised: Sequence[Factors], bits: Bools) -> Floats:
    """`time_s` of several photos, (K,), by their codes (K, N). Codes that light no cell, which
    exist on grids of a few cells, are taken to be shown for the mean time of the others."""
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
