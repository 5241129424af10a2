"""Where each cell gets its sharp light from, by a handful of photos: the map of a mirror.

Eight photos of single codes through an open mask are too few to search all rows of T for paths one
by one (`pdcd.codes.pilot.pursuit` wants 32): thousands of cells share some eighty codes, and by
chance alone many explain the light of any cell. But mirrors, glass and glossy walls are smooth:
cells that are neighbours see cells that are neighbours. A cell's photos are fitted as

    y_k = b / 2 + d c_kn + s q_km,

smooth light b, direct light d, and light s of a partner at m, whose code q is that of one cell, of
a point between cells or of a small patch (`_shapes`). How well each partner explains the photos is
a log likelihood for every pair (n, m); sum-of-evidence messages between neighbours (max-product
belief propagation on the grid, Pearl 1988) then let a whole region agree on one smooth map.

Partners with nearly the same code as the cell itself cannot be told from direct light. There, and
wherever else photos say little, b and s are drawn to what they are around: normal priors, whose
means and spreads come from the fit before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats, Singles

_Cells = NDArray[np.intp]
_Grid = tuple[int, int]

MOST_MATCHING_CELLS = 4096
"""Cells beyond which the N x N tables of a match would not fit into 2 GiB."""
OTHER = 0.1
"""Standard deviation of all light that the fit leaves out, over the RMS of indirect light. On
mirrors from 0.07 to 0.14 does as well."""
_ROUNDING = 1e-6
"""Share of all light below which there is no indirect light to speak of."""
_ROUNDS = 2
"""Times that the whole map is looked for; from the second on with priors from around."""
_FITS = 3
"""Times that the strengths are fitted in each round."""
_MESSAGES = 4
"""Steps by which a cell hears of others."""
FAR_COST = 1.0
"""What it costs in log likelihood that partners of neighbours are two cells apart, not one or none:
maps are rarely that steep."""
BREAK_COST = 8.0
"""What two neighbours with unrelated partners cost: the edge of a mirror."""
_WIDTH_B, _WIDTH_S = 2.0, 1.2
"""Standard deviations in cells over which smooth and sharp light are alike."""
_EVIDENCE = 10.0
"""Squared light of a partner over its variance from which a cell is more likely to have one."""
MATCHING_REACH = 3
"""Cells in each direction that foretell the partner of one."""
LEAST_SPREAD = 0.4
"""Standard deviation in cells of partners about what the cells around foretell, at best."""
_LEAST_WEIGHT = 0.01
"""Posterior weight below which a partner is left out of the paths."""
_CHUNK = 2**18
"""Pairs of cells scored at once."""

_WAYS = ((0, 1), (0, -1), (1, 0), (-1, 0))
"""Where the messages go: each way beside that back."""

_BESIDE = {
    0: (slice(None), slice(None)),
    1: (slice(1, None), slice(None, -1)),
    -1: (slice(None, -1), slice(1, None)),
}
"""Columns that hear, and that speak, by the step to the right."""
_QUARTERS = (0.0, 0.25, 0.5, 0.75)
_BETWEEN = (
    *((0.0, x) for x in _QUARTERS),
    *((y, 0.0) for y in _QUARTERS[1:]),
    *((y, x) for y in (0.25, 0.75) for x in (0.25, 0.75)),
    (0.5, 0.5),
)
_PATCHES = (0.6, 1.0)


@dataclass(frozen=True)
class _Round:
    """Priors of smooth light and of a partner's: mean and variance, (N,) each."""

    smooth: Floats
    smooth_var: Floats
    sharp: Floats
    sharp_var: Floats


@dataclass(frozen=True)
class _Partners:
    """What the map says: likely partners of each cell (N, M), and their log priors by it."""

    cells: _Cells
    log_prior: Floats


def find_partners(codes: Bools, photos: Floats, grid: _Grid, noise: Floats) -> _Partners:
    """Look for the smooth map of partners of all cells.

    Parameters
    ----------
    codes : (K, N) bool, lit cells of each photo, K at least 8.
    photos : (K, N) float64, ``T i_k``.
    grid : (rows, cols), at most `MOST_MATCHING_CELLS` in all.
    noise : (N,) float64, standard deviation of a cell's photos.
    """
    shapes = _shapes(grid)
    coarse = [shapes[i] for i in (0, 2, 5, 11, 12, 13)]
    likelihood = _Likelihood(codes, photos, noise)
    priors = likelihood.widest()
    for _ in range(_ROUNDS):
        own = likelihood.all_pairs(coarse, priors)
        heard = _messages(own.reshape(*grid, *grid))
        heard = heard.reshape(own.shape)
        best = (own + heard).argmax(axis=1)
        around = _around(best, grid)
        partners = _Partners(around, np.take_along_axis(heard, around, axis=1).astype(np.float64))
        priors = _fit(likelihood, partners, shapes, grid)[1]
    return partners


def weigh_partners(
    partners: _Partners, codes: Bools, photos: Floats, grid: _Grid, noise: Floats
) -> Any:
    """Fit the light of known partners in one channel; arguments as of `find_partners`.

    Returns
    -------
    sparse CSR array (N, N) float64
        Expected entries of T, >= 0, none on the diagonal.
    """
    likelihood = _Likelihood(codes, photos, noise)
    return _fit(likelihood, partners, _shapes(grid), grid)[0] * likelihood.unit


class _Likelihood:
    """Photos of each cell, with direct light left free and the rest as normal deviates.

    All in the `unit` of the photos that is the RMS of their indirect light.
    """

    def __init__(self, codes: Bools, photos: Floats, noise: Floats) -> None:
        self.codes: Floats = codes.astype(np.float64)
        own = self.codes - self.codes.mean(axis=0)
        slope = np.sum(own * photos, axis=0) / np.sum(own**2, axis=0)
        indirect = 2.0 * (photos.mean(axis=0) - self.codes.mean(axis=0) * slope)
        least = _ROUNDING * float(np.sqrt(np.mean(photos**2)))
        self.unit = max(float(np.sqrt(np.mean(indirect**2))), least) or 1.0
        self.photos: Floats = photos / self.unit
        self.variance: Floats = OTHER**2 + (noise / self.unit) ** 2
        self._usual = float(np.median(indirect)) / self.unit

    def widest(self) -> _Round:
        """Priors that say no more than how much indirect light there is in all."""
        cells = self.photos.shape[1]
        return _Round(np.full(cells, self._usual), np.ones(cells), np.zeros(cells), np.ones(cells))

    def metric(self, priors: _Round) -> tuple[Floats, Floats, Floats]:
        """Inverse covariance of a cell's photos with direct light projected out, (N, K, K); its
        product with what the photos have over the smooth light, (N, K); and their square, (N,)."""
        count = len(self.codes)
        code = self.codes.T
        covariance = self.variance[:, None, None] * np.eye(count) + (
            priors.smooth_var[:, None, None] / 4.0
        )
        inverse = np.linalg.inv(covariance)
        turned = np.einsum("nij,nj->ni", inverse, code)
        norm = np.einsum("ni,ni->n", turned, code)
        metric: Floats = inverse - turned[:, :, None] * turned[:, None, :] / norm[:, None, None]
        over = (self.photos - priors.smooth / 2.0).T
        product: Floats = np.einsum("nij,nj->ni", metric, over)
        return metric, product, np.maximum(np.einsum("ni,ni->n", product, over), 0.0)

    def all_pairs(self, shapes: Sequence[Any], priors: _Round) -> Singles:
        """Log likelihood of every pair of cell and partner, (N, N), by its best shape."""
        metric, product, square = (a.astype(np.float32) for a in self.metric(priors))
        cells = len(square)
        best = np.full((cells, cells), -np.inf, dtype=np.float32)
        upper = np.triu_indices(len(self.codes))
        twice = np.where(upper[0] == upper[1], 1.0, 2.0)[:, None]
        flat = np.ascontiguousarray(metric[:, upper[0], upper[1]])
        step = max(1, _CHUNK // cells)
        for shape in shapes:
            seen = self.codes @ shape.T
            pairs = (seen[upper[0]] * seen[upper[1]] * twice).astype(np.float32)
            seen = seen.astype(np.float32)
            for start in range(0, cells, step):
                part = slice(start, start + step)
                found = _log_likelihood(
                    product[part] @ seen,
                    np.maximum(flat[part] @ pairs, 0.0),
                    square[part, None],
                    priors.sharp[part, None].astype(np.float32),
                    priors.sharp_var[part, None].astype(np.float32),
                    len(self.codes),
                )[1]
                np.maximum(best[part], found, out=best[part])
        return best


def _log_likelihood(
    inner: Any, information: Any, square: Any, mean: Any, variance: Any, count: int
) -> tuple[Any, Any]:
    """Likeliest light of a partner, and its log likelihood with a tail for what is left out.

    Student's t for the misfit, by the degrees of freedom that direct and smooth light leave.
    """
    light = np.maximum((inner + mean / variance) / (information + 1.0 / variance), 0.0)
    misfit = square - 2.0 * light * inner + light**2 * information
    misfit += (light - mean) ** 2 / variance
    free = count - 2
    log = -0.5 * free * np.log1p(np.maximum(misfit, 0.0) / free)
    return light, log - 0.5 * np.log1p(information * variance)


def _messages(own: Singles) -> Singles:
    """What the neighbours say of each cell's partners, (rows, cols, rows, cols)."""
    rows = len(own)
    said = np.zeros((len(_WAYS), *own.shape), dtype=np.float32)
    for step in range(_MESSAGES):
        total = said.sum(axis=0)
        total += own
        new = np.zeros_like(said)
        for way, (down, right) in enumerate(_WAYS):
            hears, speaks = _BESIDE[right]
            for row in range(max(0, -down), rows - max(0, down)):  # one fits into the cache
                told = _told(total[row] - said[way ^ 1, row])
                new[way, row + down, hears] = told[speaks]
        if step > 0:  # The mean of old and new: messages that run in circles would swing otherwise.
            new += said
            new *= 0.5
        said = new
    heard: Singles = said.sum(axis=0)
    return heard


def _told(belief: Singles) -> Singles:
    """A cell's message to a neighbour: partners near its own likely ones are likely too."""
    best = belief.max(axis=(-2, -1), keepdims=True)
    near = _spread(belief)
    far = _spread(near)
    message: Singles = np.maximum(near, far - np.float32(FAR_COST)) - best
    return np.maximum(message, np.float32(-BREAK_COST))


def _spread(belief: Singles) -> Singles:
    """Of each cell and the eight around it the highest belief, in the last two axes."""
    above = belief.copy()
    np.maximum(above[..., 1:, :], belief[..., :-1, :], out=above[..., 1:, :])
    np.maximum(above[..., :-1, :], belief[..., 1:, :], out=above[..., :-1, :])
    beside = above.copy()
    np.maximum(beside[..., 1:], above[..., :-1], out=beside[..., 1:])
    np.maximum(beside[..., :-1], above[..., 1:], out=beside[..., :-1])
    return beside


def _around(best: _Cells, grid: _Grid) -> _Cells:
    """Cells about the likeliest partner, (N, 15)."""
    row, col = np.divmod(best, grid[1])
    down, right = (a.ravel() for a in np.mgrid[-1:2, -2:3])
    rows = np.clip(row[:, None] + down, 0, grid[0] - 1)
    around: _Cells = rows * grid[1] + np.clip(col[:, None] + right, 0, grid[1] - 1)
    return around


def _fit(
    likelihood: _Likelihood, partners: _Partners, shapes: Sequence[Any], grid: _Grid
) -> tuple[Any, _Round]:
    """Expected paths (N, N) to the partners, and the priors that the fit gives for the next."""
    codes, photos, variance = likelihood.codes, likelihood.photos, likelihood.variance
    count, cells = codes.shape
    by_cell = np.stack([(codes @ shape.T).T for shape in shapes], axis=1)  # (N, S, K)
    seen = by_cell[partners.cells].swapaxes(1, 2).reshape(cells, -1, count)  # (N, S M, K)
    each = (cells, len(shapes), -1)
    row, col = np.divmod(partners.cells, grid[1])
    offsets = np.array([*_BETWEEN, *((0.0, 0.0) for _ in _PATCHES)])
    places = np.stack([row, col])[:, None] + offsets.T[:, :, None, None]  # (2, S, N, M)
    by_map: Any = 0.0
    priors = likelihood.widest()
    for _ in range(_FITS):
        metric, product, square = likelihood.metric(priors)
        inner = (seen @ product[:, :, None]).reshape(each).swapaxes(0, 1)  # (S, N, M)
        information = np.sum((seen @ metric) * seen, axis=2).reshape(each).swapaxes(0, 1)
        light, log = _log_likelihood(
            inner,
            np.maximum(information, 0.0),
            square[:, None],
            priors.sharp[:, None],
            priors.sharp_var[:, None],
            count,
        )
        log = log + partners.log_prior + by_map
        weight = np.exp(log - log.max(axis=(0, 2), keepdims=True))
        weight /= weight.sum(axis=(0, 2), keepdims=True)
        expected = weight * light
        sharp = expected.sum(axis=(0, 2))
        evidence = np.sum(weight * light**2 * information, axis=(0, 2))
        sure = evidence / (evidence + _EVIDENCE)
        by_map = _map_prior(places, weight, sure, grid)
        light_of = expected.swapaxes(0, 1).reshape(cells, 1, -1)
        left = photos - (light_of @ seen)[:, 0].T
        smooth = _smooth_light(codes, left, variance, priors)
        priors = _Round(
            *_local(smooth, _WIDTH_B, grid, variance),
            *_local(sharp, _WIDTH_S, grid, 0.25 * variance),
        )
    paths = scipy.sparse.csr_array((cells, cells))
    for shape, share, strength in zip(shapes, weight, expected, strict=True):
        row, place = np.nonzero((share > _LEAST_WEIGHT) & (strength > 0.0))
        table = (strength[row, place], (row, partners.cells[row, place]))
        paths = paths + scipy.sparse.csr_array(table, shape=(cells, cells)) @ shape
    paths = paths - scipy.sparse.diags_array(paths.diagonal())
    paths.eliminate_zeros()
    return paths.tocsr(), priors


def _map_prior(places: Floats, weight: Floats, sure: Floats, grid: _Grid) -> Floats:
    """Log prior of partners (S, N, M) by a plane through those of the cells around.

    Cells count by how `sure` it is (N,) that they have a partner; a cell itself does not count.
    """
    sure = sure.reshape(grid)
    own = np.einsum("snm,dsnm->dn", weight, places).reshape(2, *grid)
    y, x = np.mgrid[: grid[0], : grid[1]].astype(np.float64)
    reach = np.arange(-MATCHING_REACH, MATCHING_REACH + 1)
    bell = np.exp(-np.add.outer(reach**2, reach**2) / MATCHING_REACH)
    bell[MATCHING_REACH, MATCHING_REACH] = 0.0

    def around(of: Floats) -> Floats:
        out: Floats = scipy.ndimage.convolve(of, bell, mode="constant").ravel()
        return out

    # Moments about each cell: coordinates relative to it, from sums of absolute ones.
    at_y, at_x = y.ravel(), x.ravel()
    w, wy, wx = around(sure), around(sure * y), around(sure * x)
    wyy, wxx, wxy = around(sure * y * y), around(sure * x * x), around(sure * x * y)
    normal = np.empty((at_y.size, 3, 3))
    normal[:, 0, 0] = w
    normal[:, 0, 1] = normal[:, 1, 0] = wy - at_y * w
    normal[:, 0, 2] = normal[:, 2, 0] = wx - at_x * w
    normal[:, 1, 1] = wyy - 2.0 * at_y * wy + at_y**2 * w
    normal[:, 2, 2] = wxx - 2.0 * at_x * wx + at_x**2 * w
    normal[:, 1, 2] = normal[:, 2, 1] = wxy - at_y * wx - at_x * wy + at_y * at_x * w
    normal += np.diag([1e-6, 0.3, 0.3])
    predicted, spread = [], np.zeros(at_y.size)
    for axis in range(2):
        p = own[axis]
        wp, wpy, wpx = around(sure * p), around(sure * p * y), around(sure * p * x)
        right = np.stack([wp, wpy - at_y * wp, wpx - at_x * wp], axis=1)
        fit = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        predicted.append(fit[:, 0])
        spread += around(sure * p * p) - np.einsum("ni,ni->n", fit, right)
    variance = np.maximum(spread, 0.0) / (2.0 * np.maximum(w, 1e-6)) + LEAST_SPREAD**2
    apart = sum((places[axis] - predicted[axis][:, None]) ** 2 for axis in range(2))
    trust = w / (w + 1.0)
    log: Floats = -np.minimum(0.5 * apart / variance[:, None], BREAK_COST) * trust[:, None]
    return log


def _smooth_light(codes: Floats, left: Floats, variance: Floats, priors: _Round) -> Floats:
    """Likeliest smooth light of each cell once its partner's is gone, direct light being free."""
    own, count = codes.sum(axis=0), len(codes)
    half = 0.5 / variance
    a, b, c = 0.5 * count * half + 1.0 / priors.smooth_var, own * half, own / variance
    first = left.sum(axis=0) * half + priors.smooth / priors.smooth_var
    second = np.sum(codes * left, axis=0) / variance
    smooth: Floats = (first * c - second * b) / (a * c - b * b)
    return smooth


def _local(values: Floats, width: float, grid: _Grid, least: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of values (N,) around each cell; the variance is `least` (N,) or more."""

    def mean(of: Floats, sigma: float) -> Floats:
        out: Floats = scipy.ndimage.gaussian_filter(of.reshape(grid), sigma).ravel()
        return out

    middle = mean(values, width)
    return middle, np.maximum(mean((values - middle) ** 2, 1.25 * width), least)


@lru_cache(maxsize=1)
def _shapes(grid: _Grid) -> tuple[Any, ...]:
    """Operators (N, N) from a code to that seen at each partner: points between cells, patches."""
    stencils = []
    for down, right in _BETWEEN:
        taps = {(0, 0): (1 - down) * (1 - right), (0, 1): (1 - down) * right}
        stencils.append({**taps, (1, 0): down * (1 - right), (1, 1): down * right})
    for width in _PATCHES:
        reach = range(-2, 3)
        bell = {(y, x): np.exp(-(y * y + x * x) / (2 * width**2)) for y in reach for x in reach}
        total = sum(bell.values())
        stencils.append({at: weight / total for at, weight in bell.items()})
    return tuple(_operator(stencil, grid) for stencil in stencils)


def _operator(stencil: dict[tuple[int, int], float], grid: _Grid) -> Any:
    """Weighted sum of the cells about each cell, those beyond the border taken at it."""
    cells = grid[0] * grid[1]
    row, col = np.divmod(np.arange(cells), grid[1])
    total = scipy.sparse.csr_array((cells, cells))
    for (down, right), weight in stencil.items():
        if weight > 0.0:
            there = np.clip(row + down, 0, grid[0] - 1) * grid[1]
            there = there + np.clip(col + right, 0, grid[1] - 1)
            table = (np.full(cells, weight), (np.arange(cells), there))
            total = total + scipy.sparse.csr_array(table, shape=(cells, cells))
    return total
