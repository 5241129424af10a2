"""A pilot: a few codes photographed one by one, which tell where sharp indirect light comes from.

Its first photos, the scouts, tell whether there is any (`estimate_sharpness`): where indirect light
is smooth the pilot ends with them, and the rest of its codes go to the coded photo.

Part of the codes is shown with the mask fully open, one RAW file each. Photo k then holds ``y_k = T
i_k`` for every cell. In each code half of the time of every cell is light, so twice the deviation
from the mean photo is ``T h_k`` with h_k = +-1: for each row of T as many random projections as
there are pilot codes. Mirrors and caustics make rows with few strong entries. Pilots of 8 to 16
photos look for a smooth map of them (`pdcd.codes.pilot.matching`), those from 32 on for each row's
own by matching pursuit (`pdcd.codes.pilot.pursuit`), which needs no map and works on any grid. The
remaining codes are then made so that no two linked cells share a code (`pdcd.codes.hadamard`), and
what they still get wrong of the paths found is known and removed.

Where a pilot takes all codes there is no coded photo: the pilot's own photos are masked in software
(`pdcd.recipes.alternatives`), and the paths found correct that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats
from pdcd.codes.pilot.codes import SCOUTS
from pdcd.codes.pilot.matching import find_partners, weigh_partners
from pdcd.codes.pilot.pursuit import pursue_paths
from pdcd.codes.pilot.scene_light import (
    check_photos,
    compute_projections,
    estimate_direct_light,
    to_signs,
)
from pdcd.errors import ConfigError

SHARP = 0.15
"""`estimate_sharpness` from which a pilot goes on. On the diffuse scenes of 24 x 32 and 48 x 64
cells here it is 0.004 to 0.11, in front of mirrors and a mirror ball 0.22 to 0.75."""
PATH_CHUNK, _ROWS = 2**17, 32
"""Paths whose weights are summed up at once, and rows of factors that are looked into meanwhile."""

BESIDE = 0.25
"""Share of a partner's light that a cell gets from each of those beside it, where its quads look up
to half a cell from its middle: an eighth of what all places of a partner in its cell would make,
twice as much where it lies at a side."""
_SURE = 3.0
"""Standard errors by which sharp light stands above the noise where ambient light was taken off:
without, that noise is far below the limit."""


def estimate_sharpness(
    codes: Bools,
    photos: Floats,
    *,
    sigma: float | Floats = 0.0,
    taken_off: Floats | None = None,
) -> float:
    """How much of the indirect light comes along few, sharp paths, by the scouts alone.

    Hadamard codes light as many cells as they darken all around each cell. Smooth light then makes
    all photos alike, and a sharp path makes them differ: what they differ by, beside the direct
    light, estimates ``sqrt(mean_n Q_n / mean_n S_n^2)``, S_n being the indirect light of a cell and
    Q_n the sum of the squares of its paths. It is about 1 / sqrt(number of paths a cell), or less
    for smooth light. Texture and direct light, if it stays within its cell, do not matter.

    Parameters
    ----------
    codes, photos, sigma :
        As for `estimate_links`, the codes the `SCOUTS` first of `make_pilot_codes`.
    taken_off : (N,) float64
        Variance of the ambient light that was taken off all photos alike; None where none was. The
        noise that this light leaves in the photos is then far above that of the indirect light: it
        is taken off all squares, and only what is surely above it counts.
    """
    check_photos(codes, photos, codes.shape[1])
    count, cells = codes.shape
    direct = estimate_direct_light(codes, photos)
    indirect = 2.0 * photos.mean(axis=0) - direct
    rest = compute_projections(photos) - to_signs(codes) * direct
    # The mean photo and the direct light take a dimension each. Of all other light, the share
    # 1 / (count - 1) has the sign of the cell's own code, and went into the direct light.
    noise = 4.0 * float(np.mean(np.square(np.broadcast_to(sigma, photos.shape))))
    square = float(np.mean(np.sum(rest**2, axis=0))) / (count - 2) - noise
    total = float(np.mean(indirect**2))
    if taken_off is not None:
        square -= _SURE * noise * float(np.sqrt(2.0 / ((count - 2) * cells)))
        # The indirect light is the mean of half of the photos, four times: those that a cell was
        # dark in.
        blur = 2.0 * noise / count + 4.0 * float(np.mean(taken_off))
        total = max(total - blur, _SURE * blur * float(np.sqrt(2.0 / cells)))
    share = (count - 1) / count * max(square, 0.0)
    return float(np.sqrt(share / total)) if total > 0.0 else 0.0


def estimate_links(
    codes: Bools, photos: Floats, grid: tuple[int, int], *, sigma: float | Floats = 0.0
) -> Any:
    """Find the strong paths between different cells.

    Parameters
    ----------
    codes : (K0, N) bool
        What the projector showed, each cell lit in exactly half of the codes.
    photos : (K0, N) float64
        One photo per code with the mask fully open, black level removed: ``T i_k``.
    grid : (rows, cols)
        Cells of the scene, N in all.
    sigma : float or array broadcastable to (K0, N)
        Standard deviation of the noise of `photos`, in their unit.

    Returns
    -------
    sparse CSR array (N, N) float64
        Estimated entries of T, > 0, none on the diagonal, and none where light is spread smoothly.

    Raises
    ------
    ConfigError
        The arrays do not fit each other, or a cell is not lit in half of the codes.
    """
    check_photos(codes, photos, grid[0] * grid[1])
    level = 2.0 * np.sqrt(np.mean(np.square(np.broadcast_to(sigma, photos.shape)), axis=0))
    return pursue_paths(to_signs(codes), compute_projections(photos), grid, level)


def match_links(
    codes: Bools, photos: Floats, grid: tuple[int, int], *, sigma: Floats
) -> tuple[Any, ...]:
    """Find the smooth map of partners, and the light of each by channel.

    Parameters
    ----------
    codes : (K0, N) bool, one of the short pilots of `make_pilot_codes`.
    photos, sigma : (K0, N, C) float64, as for `estimate_links`, of C channels.
    grid : (rows, cols), N in all.

    Returns
    -------
    sparse CSR arrays (N, N), of all channels together and of each: C + 1 in all
        As of `estimate_links`, but entries wherever the map leads, small ones where there is little
        light to be had.
    """
    channels = photos.shape[2]
    noise = np.sqrt(np.mean(sigma**2, axis=0))
    grey = photos.mean(axis=2), np.sqrt(np.sum(noise**2, axis=1)) / channels
    partners = find_partners(codes, grey[0], grid, grey[1])
    alike = all(np.array_equal(photos[..., 0], photos[..., c]) for c in range(1, channels))
    if alike:
        one = weigh_partners(partners, codes, photos[..., 0], grid, noise[:, 0])
        return tuple(one for _ in range(channels + 1))
    own = [
        weigh_partners(partners, codes, photos[..., c], grid, noise[:, c]) for c in range(channels)
    ]
    links: Any = sum(own[1:], own[0]) / channels
    return (links, *own)


def widen_links(links: Any, grid: tuple[int, int]) -> Any:
    """Links (N, N) of cells, and of as much as `BESIDE` of them to the cells beside their partners.

    What a cell's quads see in a mirror lies as far apart as they do: those at its edges see another
    cell than its middle, and codes are to keep that one apart, too. In means over cells it counts
    for little, so that no pilot tells.
    """
    path = links.tocoo()
    to, at = path.coords
    row, col = np.divmod(at, grid[1])
    total = links
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        there = (row + down, col + right)
        inside = (there[0] >= 0) & (there[0] < grid[0]) & (there[1] >= 0) & (there[1] < grid[1])
        number = there[0] * grid[1] + there[1]
        kept = inside & (number != to)
        table = (BESIDE * path.data[kept], (to[kept], number[kept]))
        total = total + scipy.sparse.csr_array(table, shape=links.shape)
    return total


def compute_path_correction(
    left: Floats, right: Floats, weight: float | Floats, paths: Any, wanted: float | Floats = 1.0
) -> Floats:
    """Return what to add to an image for the paths found: (N,) float64, in units of T.

    The image counts the path from m to n with ``A_nm / weight_n`` where W_nm is wanted; over the
    modelled paths the difference is known exactly (a control variate).

    Parameters
    ----------
    left, right : (R, N) float64
        Factors of the realised probing matrix, ``A = left.T @ right``
        (`pdcd.probing.realised.Factors`).
    weight : float, or (N,) of each cell
        Weight the image was divided by, in the unit of A.
    paths : sparse (N, N)
        Paths of `estimate_links`.
    wanted : float, or (P,) of each path in the order of its entries
        W_nm.
    """
    table = scipy.sparse.coo_array(paths)
    row, col = table.coords
    realised = np.zeros(row.size)
    for start in range(0, row.size, PATH_CHUNK):
        part = slice(start, start + PATH_CHUNK)
        for first in range(0, left.shape[0], _ROWS):  # few rows of each, which a cache holds
            lit, opened = left[first : first + _ROWS], right[first : first + _ROWS]
            one, other = np.take(lit, row[part], axis=1), np.take(opened, col[part], axis=1)
            realised[part] += np.einsum("rp,rp->p", one, other)
    missing = np.zeros(left.shape[1])
    own = np.broadcast_to(weight, missing.shape)
    np.add.at(missing, row, (wanted - realised / own[row]) * table.data)
    return missing


CLEARLY = 0.7
"""Error with the paths found, over that without, from which they are believed. Few are there in
smooth light, and avoiding what is not there disturbs the codes a little."""


@dataclass(frozen=True)
class PilotPrediction:
    """Predicted RMS errors of the indirect image, over the RMS of the true one, for the codes after
    a pilot: `piloted` if they avoid the paths found, `unguided` if they do not.
    """

    piloted: float
    unguided: float

    @property
    def pays(self) -> bool:
        """Whether to avoid the paths found. What the pilot has cost is spent either way."""
        return self.piloted < CLEARLY * self.unguided


def predict_pilot_errors(
    codes: Bools,
    photos: Floats,
    paths: Any,
    count: int,
    *,
    sigma: float | Floats = 0.0,
) -> PilotPrediction:
    """Predict from the photos of `make_pilot_codes` whether to use the paths found.

    Each of the two Hadamard sets of the pilot estimates the direct image; both hold the same truth,
    so their difference shows the error of that many codes. Photos without the light of the paths
    found show in the same way the error of codes that avoid these paths. Errors are carried over
    to other numbers of codes by the share of pairs of cells that have a code in common: right for
    unrelated paths, too much for smooth light, and this for both ways alike. Where each set keeps
    all cells apart, or there is no indirect light, nothing can be told, and nothing pays: all 0.

    Parameters
    ----------
    codes, photos, sigma :
        As for `estimate_links`, the codes those of `make_pilot_codes`.
    paths : sparse (N, N)
        What `estimate_links` found.
    count : int
        Number of codes in all, pilot included; more than the pilot has.

    Raises
    ------
    ConfigError
        The pilot leaves no codes, or the arrays do not fit each other.
    """
    check_photos(codes, photos, paths.shape[0])
    pilot, quarter = codes.shape[0], codes.shape[0] // 4
    if count <= pilot:
        raise ConfigError(
            f"a pilot of {pilot} leaves nothing of {count} codes", hint="take more codes"
        )
    first = slice(SCOUTS, SCOUTS + quarter)
    second = slice(SCOUTS + quarter, SCOUTS + 2 * quarter)
    cleared = photos - (paths @ codes.T.astype(np.float64)).T
    noise = np.broadcast_to(sigma, photos.shape)[first.start : second.stop]
    blur = 8.0 / quarter * np.mean(noise**2)  # variance of a difference of two direct images
    indirect = 2.0 * photos.mean(axis=0) - estimate_direct_light(codes, photos)
    light, shared = float(np.mean(indirect**2)), _shared(quarter, codes.shape[1])
    if light == 0.0 or shared == 0.0:
        return PilotPrediction(piloted=0.0, unguided=0.0)
    spread = []
    for series in (photos, cleared):
        differ = estimate_direct_light(codes[first], series[first]) - estimate_direct_light(
            codes[second], series[second]
        )
        square = max(float(np.mean(differ**2) - blur), 0.0) / 2.0
        spread.append(square / light / shared)
    left = _shared(count - pilot, codes.shape[1])
    return PilotPrediction(
        piloted=float(np.sqrt(spread[1] * left)),
        unguided=float(np.sqrt(spread[0] * left)),
    )


def _shared(count: int, cells: int) -> float:
    """Share of the pairs of cells that have the same of `count` - 1 columns, all used alike."""
    if count < 2:
        return 1.0
    return max(cells / (count - 1) - 1.0, 0.0) / max(cells - 1, 1)
