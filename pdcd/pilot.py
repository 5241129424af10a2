"""A pilot: a few codes photographed one by one, which tell where sharp indirect light comes from.

Its first photos, the scouts, tell whether there is any (`sharpness`): where indirect light is
smooth the pilot ends with them, and the rest of its codes go to the coded photo.

Part of the codes is shown with the mask fully open, one RAW file each. Photo k then holds
``y_k = T i_k`` for every cell. In each code half of the time of every cell is light, so twice the
deviation from the mean photo is ``T h_k`` with h_k = +-1: for each row of T as many random
projections as there are pilot codes. Mirrors and caustics make rows with few strong entries.
Pilots of 8 to 16 photos look for a smooth map of them (`pdcd.matching`), those from 32 on for each
row's own by matching pursuit (`pdcd.pursuit`), which needs no map and works on any grid. The
remaining codes are then made so that no two linked cells share a code (`pdcd.codes.prior`), and
what they still get wrong of the paths found is known and removed.

Where a pilot takes all codes there is no coded photo: the pilot's own photos are masked in software
(`pdcd.alternatives`), and the paths found correct that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.codes.orders import is_order
from pdcd.errors import ConfigError
from pdcd.matching import MOST_CELLS, find_partners, weigh
from pdcd.pursuit import pursue

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

POWERS = (32, 64, 128)
"""Pilot photos with which single paths are looked for. With fewer, chance matches outnumber true
ones; more would show no more paths than a scene has."""
MATCHED = (8, 12, 16)
"""Pilot photos with which a smooth map is looked for instead."""
TILE = 4
"""Side of the squares of cells that get different codes, as far as these go."""
SCOUTS = 4
"""First photos of a pilot, after which it goes on or ends."""
SHARP = 0.15
"""`sharpness` from which a pilot goes on. On the diffuse scenes of 24 x 32 and 48 x 64 cells here
it is 0.004 to 0.11, before mirrors and a mirror ball 0.22 to 0.75."""
CLEARLY = 0.7
"""Error with the paths found, over that without, from which they are believed. Few are there in
smooth light, and avoiding what is not there disturbs the codes a little."""
CHUNK = 2**22
"""Numbers held at once when the weights of single paths are summed up."""


def pilot_share(count: int, *, by_map: bool) -> int:
    """Return how many of `count` codes to spend on a pilot; 0 if a pilot cannot be had.

    At most two thirds of the codes, and leaving a Hadamard order for the shot: one that looks
    `by_map`, or else a power of two.
    """
    for share in reversed(MATCHED if by_map else POWERS):
        if 3 * share <= 2 * count and is_order(count - share):
            return share
    return 0


def pilot_codes(lattice: tuple[int, int], count: int, seed: int) -> Bools:
    """Make the codes of a pilot, (count, L) bool.

    The scouts come first, as `hadamard` codes (`sharpness`); `count` may be their number alone. The
    other codes of a pilot that looks for a map are lit in half of the photos, give or take one:
    more different codes for next cells, and fewer cells that cannot be told from their partners,
    than if all were lit equally often.

    In longer pilots each cell is lit in exactly half of the codes. Two more sets of `hadamard`
    codes, a quarter each, tell by how much they disagree what codes alone would get wrong
    (`worth`). The others are `balanced`: independent cells, any few of which can be told apart, as
    the search for paths needs it.

    Raises
    ------
    ConfigError
        No pilot has that many codes, the lattice is empty, or too fine to look for a map.
    """
    if count == SCOUTS or count in MATCHED:
        if count > SCOUTS and lattice[0] * lattice[1] > MOST_CELLS:
            raise ConfigError(
                f"a pilot of {count} codes looks for a map of at most {MOST_CELLS} cells",
                hint=f"take a power of two from {POWERS[0]}, or a coarser grid",
            )
        scouts = make_codes("hadamard", lattice, SCOUTS, dual="complement", seed=4 * seed).primal()
        return np.concatenate([scouts, _varied(lattice, count - SCOUTS, seed)])
    quarter = count // 4
    if count % 4 or not is_order(quarter) or count < POWERS[0]:
        raise ConfigError(
            f"a pilot of {count} codes cannot be made",
            hint=f"take one of {MATCHED}, or a power of two from {POWERS[0]}",
        )
    rest = count - 2 * quarter - SCOUTS
    kinds = (
        ("hadamard", SCOUTS),
        ("hadamard", quarter),
        ("hadamard", quarter),
        ("balanced", rest),
    )
    parts = [
        make_codes(family, lattice, part, dual="complement", seed=4 * seed + i).primal()
        for i, (family, part) in enumerate(kinds)
    ]
    return np.concatenate(parts)


def _varied(lattice: tuple[int, int], count: int, seed: int) -> Bools:
    """Codes (count, L) by chance, lit in half of `count` or one more or less; none for 0.

    Cells of a tile have different ones as long as there are any.
    """
    rows, cols = lattice
    all_codes = np.arange(2**count)[:, None] >> np.arange(count) & 1
    own = np.flatnonzero(np.abs(all_codes.sum(axis=1) - count / 2) <= 1)
    rng = np.random.Generator(np.random.PCG64([seed, 3]))
    chosen = np.empty((-(-rows // TILE), -(-cols // TILE), TILE * TILE), dtype=np.intp)
    again = -(-chosen.shape[2] // own.size)
    for tile in np.ndindex(chosen.shape[:2]):
        drawn = np.concatenate([rng.permutation(own) for _ in range(again)])[: chosen.shape[2]]
        chosen[tile] = rng.permutation(drawn)
    down, right = chosen.shape[:2]
    image = chosen.reshape(down, right, TILE, TILE).swapaxes(1, 2).reshape(down * TILE, -1)
    codes: Bools = all_codes[image[:rows, :cols].ravel()].T.astype(np.bool_)
    return codes


def sharpness(codes: Bools, photos: Floats, *, sigma: float | Floats = 0.0) -> float:
    """How much of the indirect light comes along few, sharp paths, by the scouts alone.

    Hadamard codes light as many cells as they darken all around each cell. Smooth light then makes
    all photos alike, and a sharp path makes them differ: what they differ by, beside the direct
    light, estimates ``sqrt(mean_n Q_n / mean_n S_n^2)``, S_n being the indirect light of a cell and
    Q_n the sum of the squares of its paths. It is about 1 / sqrt(number of paths a cell), or less
    for smooth light. Texture and direct light, if it stays within its cell, do not matter.

    Parameters
    ----------
    codes, photos, sigma :
        As for `estimate_links`, the codes the `SCOUTS` first of `pilot_codes`.
    """
    _check(codes, photos, codes.shape[1])
    count = codes.shape[0]
    direct = _direct(codes, photos)
    indirect = 2.0 * photos.mean(axis=0) - direct
    rest = _projections(photos) - _signs(codes) * direct
    # The mean photo and the direct light take a dimension each. Of all other light, the share
    # 1 / (count - 1) has the sign of the cell's own code, and went into the direct light.
    noise = 4.0 * float(np.mean(np.square(np.broadcast_to(sigma, photos.shape))))
    square = float(np.mean(np.sum(rest**2, axis=0))) / (count - 2) - noise
    share = (count - 1) / count * max(square, 0.0)
    total = float(np.mean(indirect**2))
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
    _check(codes, photos, grid[0] * grid[1])
    level = 2.0 * np.sqrt(np.mean(np.square(np.broadcast_to(sigma, photos.shape)), axis=0))
    return pursue(_signs(codes), _projections(photos), grid, level)


def match_links(
    codes: Bools, photos: Floats, grid: tuple[int, int], *, sigma: Floats
) -> tuple[Any, ...]:
    """Find the smooth map of partners, and the light of each by channel.

    Parameters
    ----------
    codes : (K0, N) bool, one of the short pilots of `pilot_codes`.
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
        one = weigh(partners, codes, photos[..., 0], grid, noise[:, 0])
        return tuple(one for _ in range(channels + 1))
    own = [weigh(partners, codes, photos[..., c], grid, noise[:, c]) for c in range(channels)]
    links: Any = sum(own[1:], own[0]) / channels
    return (links, *own)


def correction(left: Floats, right: Floats, weight: float, paths: Any) -> Floats:
    """Return what to add to an indirect image for the paths found: (N,) float64, in units of T.

    The image counts the path from m to n with ``A_nm / weight`` where 1 is wanted; over the
    modelled paths the difference is known exactly (a control variate).

    Parameters
    ----------
    left, right : (R, N) float64
        Factors of the realised probing matrix, ``A = left.T @ right`` (`pdcd.realised.Factors`).
    weight : float
        Weight the image was divided by, in the unit of A.
    paths : sparse (N, N)
        Paths of `estimate_links`.
    """
    table = scipy.sparse.coo_array(paths)
    row, col = table.coords
    realised = np.empty(row.size)
    step = max(1, CHUNK // left.shape[0])
    for start in range(0, row.size, step):
        part = slice(start, start + step)
        realised[part] = np.einsum("rp,rp->p", left[:, row[part]], right[:, col[part]])
    missing = np.zeros(left.shape[1])
    np.add.at(missing, row, (1.0 - realised / weight) * table.data)
    return missing


@dataclass(frozen=True)
class Worth:
    """Predicted RMS errors of the indirect image, over the RMS of the true one.

    `alone` for all codes in one shot and no pilot. After a pilot, for the other codes: `piloted` if
    they avoid the paths found, `unguided` if they do not.
    """

    alone: float
    piloted: float
    unguided: float

    @property
    def pays(self) -> bool:
        """Whether to avoid the paths found. What the pilot has cost is spent either way."""
        return self.piloted < CLEARLY * self.unguided


def worth(
    codes: Bools,
    photos: Floats,
    paths: Any,
    count: int,
    *,
    sigma: float | Floats = 0.0,
) -> Worth:
    """Predict from the photos of `pilot_codes` whether to use the paths found.

    Each of the two Hadamard sets of the pilot estimates the direct image; both hold the same truth,
    so their difference shows the error of that many codes. Photos without the light of the paths
    found show in the same way the error of codes that avoid these paths. Errors are carried over
    to other numbers of codes by the share of pairs of cells that have a code in common: right for
    unrelated paths, too much for smooth light, and this for both ways alike.

    Parameters
    ----------
    codes, photos, sigma :
        As for `estimate_links`, the codes those of `pilot_codes`.
    paths : sparse (N, N)
        What `estimate_links` found.
    count : int
        Number of codes in all, pilot included; more than the pilot has.

    Raises
    ------
    ConfigError
        The pilot leaves no codes, or the arrays do not fit each other.
    """
    _check(codes, photos, paths.shape[0])
    pilot = codes.shape[0]
    if count <= pilot:
        raise ConfigError(
            f"a pilot of {pilot} leaves nothing of {count} codes", hint="take more codes"
        )
    quarter = pilot // 4
    first = slice(SCOUTS, SCOUTS + quarter)
    second = slice(SCOUTS + quarter, SCOUTS + 2 * quarter)
    cleared = photos - (paths @ codes.T.astype(np.float64)).T
    noise = np.broadcast_to(sigma, photos.shape)[first.start : second.stop]
    blur = 8.0 / quarter * np.mean(noise**2)  # variance of a difference of two direct images
    indirect = 2.0 * photos.mean(axis=0) - _direct(codes, photos)
    spread = []
    for series in (photos, cleared):
        differ = _direct(codes[first], series[first]) - _direct(codes[second], series[second])
        square = max(float(np.mean(differ**2) - blur), 0.0) / 2.0
        spread.append(square / float(np.mean(indirect**2)) / _shared(quarter, codes.shape[1]))
    alone, left = _shared(count, codes.shape[1]), _shared(count - pilot, codes.shape[1])
    return Worth(
        alone=float(np.sqrt(spread[0] * alone)),
        piloted=float(np.sqrt(spread[1] * left)),
        unguided=float(np.sqrt(spread[0] * left)),
    )


def _shared(count: int, cells: int) -> float:
    """Share of the pairs of cells that have the same of `count` - 1 columns, all used alike."""
    if count < 2:
        return 1.0
    return max(cells / (count - 1) - 1.0, 0.0) / max(cells - 1, 1)


def _signs(codes: Bools) -> Floats:
    signs: Floats = np.where(codes, 1.0, -1.0)
    return signs


def _projections(photos: Floats) -> Floats:
    """``T h_k`` (K0, N): the mean photo is ``T 1 / 2``, as every cell is lit half of the time."""
    projections: Floats = 2.0 * (photos - photos.mean(axis=0))
    return projections


def _direct(codes: Bools, photos: Floats) -> Floats:
    """Estimate the direct image (N,) from balanced signs: the mean of ``h_k (T h_k)``."""
    estimate: Floats = np.mean(_signs(codes) * _projections(photos), axis=0)
    return estimate


def _check(codes: Bools, photos: Floats, cells: int) -> None:
    if codes.ndim != 2 or codes.shape != photos.shape or codes.shape[1] != cells:
        raise ConfigError(
            f"pilot codes {codes.shape} and photos {photos.shape} do not fit {cells} cells",
            hint="give one photo of all cells for each code",
        )
    if np.any(2 * np.count_nonzero(codes, axis=0) != codes.shape[0]):
        raise ConfigError(
            "a cell is not lit in half of the pilot codes", hint="use the codes of `pilot_codes`"
        )
