"""What an indirect image itself shows of its error: light that spreads smoothly.

The image shows how much indirect light each cell n gets, S_n. Where light spreads diffusely its
paths are nearly ``x_n k(d) x_m``: how much two cells exchange depends on how much each exchanges
with all others, and on their distance d. The realised probing matrix is known, hence also what it
gets wrong of such paths. This is subtracted: a control variate that costs no photo.

The image also shows how light falls off with distance. What the codes get wrong of light that is
spread evenly over the scene is a known pattern, and so is what they get wrong of light that stays
near; both change from cell to cell like noise. As much of each as is found in the fine detail of
the image, weighed against the chance that it is texture, is removed (`pdcd.pictures.shares`). Where
a photo was taken in parts, their differences are a better measure.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats
from pdcd.pictures.shares import fit_shares_to_detail, fit_shares_to_parts

_Spread = Callable[[Floats], Floats]

HALF_LIGHT_CELLS = 2.0
"""Cells over which near light falls to one half; far off it falls with the square."""
_NEAR_SPREAD = HALF_LIGHT_CELLS, 1.0
"""Reach in cells, and power, of light ``(1 + (d / reach)^2)^-power`` at the distance d."""
_USUAL = np.array([0.0, 0.1])
"""Shares of far and of near light that are removed where the image shows nothing. Larger ones gain
more on some scenes, but do harm where light stays near and codes are nearly exact."""
_SURE = np.array([0.25, 0.2])
"""Prior standard deviations of these shares: how strong the evidence of the image must be."""
_ROUNDS = 8
"""Iterations that scale the model until its row sums are the image; each halves the error."""
_CHUNK = 2**17
"""Numbers transformed at once: what stays in the cache takes a quarter of the time."""
_FAR_SPREADS = ((np.inf, 1.0), (5.0, 1.0), (2.0, 2.0))
"""The same for photos of far light. Their codes are random and few, so that any spread of light
matters."""
_FAR_USUAL, _FAR_SURE = np.array([0.4, 0.3, 0.1]), np.array([0.3, 0.2, 0.15])
"""As `_USUAL` and `_SURE`."""


@dataclass(frozen=True, eq=False)
class CodedImage:
    """A photo, or a part of it: factors of its realised probing matrix, (R, N) each, the weight
    that it was divided by, and its image, (N,)."""

    left: Floats
    right: Floats
    weight: float | Floats
    image: Floats


def compute_colour_correction(
    left: Floats,
    right: Floats,
    weight: float | Floats,
    image: Floats,
    grid: tuple[int, int],
    alive: Callable[[], None] = lambda: None,
    beyond: int = 0,
    shares: Floats | None = None,
    seen: Bools | None = None,
) -> Floats:
    """The same as `compute_smooth_correction` for an image in colour: (N, C) float64.

    The grey light that is missing is shared out among the channels in proportion to each cell's
    light: smooth light takes on the colour of where it arrives.
    """
    light = np.maximum(image, 0.0)
    grey: Floats = light.mean(axis=1)
    missing = compute_smooth_correction(
        left, right, weight, grey, grid, alive, beyond, shares, seen
    )
    share = np.divide(missing, grey, out=np.zeros_like(grey), where=grey > 0.0)
    more: Floats = light * share[:, None]
    return more


def compute_smooth_correction(
    left: Floats,
    right: Floats,
    weight: float | Floats,
    image: Floats,
    grid: tuple[int, int],
    alive: Callable[[], None] = lambda: None,
    beyond: int = 0,
    shares: Floats | None = None,
    seen: Bools | None = None,
) -> Floats:
    """Return what to add to an image of indirect or of far light for its smooth light: (N,)
    float64, in its unit.

    Parameters
    ----------
    left, right : (R, N) float64
        Factors of the realised probing matrix, ``A = left.T @ right``
        (`pdcd.probing.realised.Factors`).
    weight : float or (N,) float64
        Weight the image, or each cell of it, was divided by, in the unit of A.
    image : (N,) float64
        The image, row-major. Where sharp paths are known (`pdcd.codes.pilot.links`), what is left
        of it without their light, their row sums.
    grid : (rows, cols)
        Cells of the scene, N in all.
    alive : called now and then, and may raise to end the work.
    beyond : the radius of an image of far light, within which the model then has no light; 0 for
        indirect light.
    shares : of each kind of light to remove (`_spreads`), where they were estimated from parts
        (`estimate_smooth_shares`); else they are estimated from the image.
    seen : (N,) bool, cells whose light is known; None for all.
    """
    light = np.maximum(image, 0.0)
    if light.size < 2 or not light.any():
        return np.zeros_like(light)
    codes = CodedImage(left, right, weight, image)
    missing = _patterns(codes, light, _spreads(codes, grid, beyond), alive)
    if shares is None:
        shares = fit_shares_to_detail(light, missing, grid, *_before(beyond), seen)
        if beyond:  # The patterns are much alike, so that their sum is limited to all of the light.
            shares = shares / max(1.0, float(shares.sum()))
    return np.asarray(shares @ missing)


def estimate_smooth_shares(
    whole: CodedImage,
    parts: Sequence[CodedImage],
    grid: tuple[int, int],
    beyond: int = 0,
    alive: Callable[[], None] = lambda: None,
    seen: Bools | None = None,
) -> Floats | None:
    """How much of each pattern to remove, (P,), from the differences of a photo's parts; None for a
    dark one.

    Each part has codes of its own and gets other amounts wrong of smooth light. All photograph the
    same scene, so texture drops out of their differences. What is left says far more than the
    detail of the image, which counts too. `beyond` and `seen` as of `compute_smooth_correction`.
    """
    light = np.maximum(whole.image, 0.0)
    if light.size < 2 or not light.any():
        return None
    kinds = _spreads(whole, grid, beyond)
    missing = _patterns(whole, light, kinds, alive)
    lacking, patterns = [], []
    for part in parts:
        counts = part.weight / whole.weight
        lacking.append(counts * (whole.image - part.image))
        patterns.append(counts * (_patterns(part, light, kinds, alive) - missing))
    return fit_shares_to_parts(light, missing, lacking, patterns, grid, *_before(beyond), seen)


def _before(beyond: int) -> tuple[Floats, Floats]:
    """Prior means of shares, and their standard deviations."""
    return (_FAR_USUAL, _FAR_SURE) if beyond else (_USUAL, _SURE)


def _spreads(
    codes: CodedImage, grid: tuple[int, int], beyond: int
) -> list[tuple[_Spread, _Spread]]:
    """Kinds of smooth light, each as its spread and the part of this that is wanted: far and near
    light, or, beyond a radius, each way in which light may fall off."""
    if beyond:
        ways = [_spread(_kernel(grid, *way, beyond), grid) for way in _FAR_SPREADS]
        return [(way, way) for way in ways]
    kernel = _kernel(grid, *_NEAR_SPREAD)
    counted = kernel.copy()
    for (row, col), share in average_neighbour_weights(
        codes.left, codes.right, codes.weight, grid
    ).items():
        counted[-row, -col] *= share
    return [(_evenly, _evenly), (_spread(kernel, grid), _spread(counted, grid))]


def _patterns(
    codes: CodedImage,
    light: Floats,
    kinds: Sequence[tuple[_Spread, _Spread]],
    alive: Callable[[], None],
) -> Floats:
    """What the codes miss of light of each kind, (P, N)."""
    own = codes.left, codes.right, codes.weight
    return np.stack([_missing(*own, light, *kind, alive) for kind in kinds])


def _missing(
    left: Floats,
    right: Floats,
    weight: float | Floats,
    light: Floats,
    spread: _Spread,
    counted: _Spread,
    alive: Callable[[], None],
) -> Floats:
    """What the codes miss of light that has this spread: (N,).

    `counted` is the part of the spread that is to be counted.
    """
    part = np.sqrt(light / spread(np.ones_like(light)).max())
    for _ in range(_ROUNDS):
        arriving = spread(part)
        seen = np.divide(light, arriving, out=np.zeros_like(light), where=arriving > 0.0)
        part = np.sqrt(part * seen)
    realised = np.zeros_like(light)
    step = max(1, _CHUNK // (4 * light.size))
    for start in range(0, left.shape[0], step):
        alive()
        chunk = slice(start, start + step)
        realised += np.einsum("rn,rn->n", left[chunk], spread(right[chunk] * part))
    missing: Floats = part * (counted(part) - realised / weight)
    return missing


def _evenly(light: Floats) -> Floats:
    """Spread images (..., N) evenly over all cells but each value's own."""
    spread: Floats = light.sum(axis=-1, keepdims=True) - light
    return spread


def average_neighbour_weights(
    left: Floats, right: Floats, weight: float | Floats, grid: tuple[int, int]
) -> dict[tuple[int, int], float]:
    """Average weight with which cells see the cells beside them, by offset (rows, columns).

    Quarter windows take light from beside a cell for light of the cell itself, and miss it. The
    detail of an image does not show this, as all cells miss alike; it is not corrected.
    """
    rows, cols = grid
    # With a dark row and column behind each image those beside a cell lie a fixed step off.
    mask, light = (
        np.pad(one.reshape(-1, rows, cols), ((0, 0), (0, 1), (0, 1))).ravel()
        for one in (left / weight, right)
    )
    found = {}
    for row, col in itertools.product((-1, 0, 1), repeat=2):
        if (row, col) == (0, 0) or abs(row) >= rows or abs(col) >= cols:
            continue
        step = row * (cols + 1) + col
        here, there = mask[max(0, -step) :], light[max(0, step) :]
        both = min(here.size, there.size)
        pairs = (rows - abs(row)) * (cols - abs(col))
        found[row, col] = float(here[:both] @ there[:both]) / pairs
    return found


def _kernel(grid: tuple[int, int], reach: float, power: float, radius: int = 0) -> Floats:
    """``(1 + (d / reach)^2)^-power`` of all offsets, those below 0 counted from the end; nothing
    within `radius`."""
    row, col = (
        np.minimum(np.arange(size), size - np.arange(size)).astype(np.float64)
        for size in _padded(grid)
    )
    kernel: Floats = (1.0 + (row[:, None] ** 2 + col**2) / reach**2) ** -power
    kernel[np.maximum(row[:, None], col) <= radius] = 0.0
    return kernel


def _padded(grid: tuple[int, int]) -> tuple[int, ...]:
    """Sizes at which images do not wrap around their edges, and whose transforms are fast."""
    return tuple(scipy.fft.next_fast_len(2 * size - 1, real=True) for size in grid)


def _spread(kernel: Floats, grid: tuple[int, int]) -> _Spread:
    """Sums over all other cells by a kernel of offsets, as a product of Fourier transforms."""
    rows, cols = grid
    height, width = kernel.shape
    waves = scipy.fft.rfft2(kernel)

    def spread(light: Floats) -> Floats:
        images = light.reshape(*light.shape[:-1], rows, cols)
        # Axis by axis: rows of the padding are 0 before, and are not asked for after.
        out = scipy.fft.fft(scipy.fft.rfft(images, n=width), n=height, axis=-2, overwrite_x=True)
        out *= waves
        out = scipy.fft.ifft(out, axis=-2, norm="forward", overwrite_x=True)[..., :rows, :]
        found = scipy.fft.irfft(out, n=width, norm="forward", overwrite_x=True)[..., :cols]
        near: Floats = (found * (1.0 / kernel.size)).reshape(light.shape)
        return near

    return spread
