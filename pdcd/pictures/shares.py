"""How much smooth light of each kind a photo holds, estimated from its errors.

What the codes get wrong of smooth light is a known pattern for each kind of it
(`pdcd.pictures.smooth`), which changes from cell to cell like noise. The amount of each pattern in
the fine detail of the image, weighed against the chance that it is texture, gives the amount of
that light. Textured surfaces hide the patterns: then little is learnt. Parts of a photo get other
amounts wrong, and their differences hold no texture.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats

_DETAIL = np.array([[-1.0, 2.0, -1.0], [2.0, -4.0, 2.0], [-1.0, 2.0, -1.0]]) / 4.0
"""Keeps what changes from cell to cell, and removes any plane."""
_AROUND = 5
"""Side, in cells, of the square over which the strength of detail is averaged."""
_DARK = 0.01
"""Light that is added to every cell, as a share of the mean light, so that none is dark."""
_LEAST = 1e-6
"""Least strength of detail, over its mean: limits the weight of cells without light."""
_ROUNDING = 1e-12
"""Strength of detail, relative to the light, below which it is rounding error: on a grid of one row
or column nothing else is left."""
_LESS_SURE = 4.0
"""Factor by which shares may deviate further from the usual ones where parts are used."""
FROM, TO = -1.0, 2.0
"""Bounds of shares where parts are used. They exceed 0 to 1, as one kind of light may compensate
for an excess of another in the model."""
_ROUNDS = 2
"""Iterations in which the strength of the residuals is estimated."""


def fit_shares_to_detail(
    light: Floats,
    missing: Floats,
    grid: tuple[int, int],
    usual: Floats,
    sure: Floats,
    seen: Bools | None = None,
) -> Floats:
    """Shares from 0 to 1, (P,), by the detail of an image alone.

    light : (N,), the image; not all dark. missing : (P, N), what it lacks of each kind of smooth
    light. usual, sure : (P,), prior mean and standard deviation of shares. seen : (N,), cells whose
    light is known, None for all.
    """
    told = _by_detail(light, missing, grid, seen)
    return np.clip(_likeliest(*told, usual, sure), 0.0, 1.0)


def fit_shares_to_parts(
    light: Floats,
    missing: Floats,
    lacking: Sequence[Floats],
    patterns: Sequence[Floats],
    grid: tuple[int, int],
    usual: Floats,
    sure: Floats,
    seen: Bools | None = None,
) -> Floats:
    """Shares from `FROM` to `TO`, (P,), by the detail of an image and the differences of its parts.

    lacking : for each part, (N,), the whole image less that of the part, times its weight over that
    of the whole. patterns : for each, (P, N), that difference as expected for each kind of light,
    times the same. Others as of `fit_shares_to_detail`.
    """
    level = light + _DARK * light.mean()
    wrong = np.stack(lacking) / level  # (B, N)
    known = np.stack(patterns, axis=1) / level  # (P, B, N)
    precision, told = _by_detail(light, missing, grid, seen)
    shares = usual
    for _ in range(_ROUNDS):
        # The residuals are noise, and light that has no pattern.
        left = wrong - np.tensordot(shares, known, 1)
        scale = _over_strength(np.mean(left**2, axis=0).reshape(grid), seen)
        scaled = known * scale
        more = np.einsum("pbn,qbn->pq", scaled, scaled)
        shares = _likeliest(
            precision + more,
            told + np.einsum("pbn,bn->p", scaled, wrong * scale),
            usual,
            _LESS_SURE * sure,
        )
    return np.clip(shares, FROM, TO)


def _by_detail(
    light: Floats, missing: Floats, grid: tuple[int, int], seen: Bools | None
) -> tuple[Floats, Floats]:
    """Normal equations for shares from the detail of an image: their precision, (P, P), and that
    times the shares, (P,). Detail is taken as normal with the strength it has around each cell."""
    # Relative to the light of each cell: a surface that is twice as bright shows twice the pattern,
    # and its texture must not be taken for one.
    level = light + _DARK * light.mean()
    lacking = -_detail(np.log(level), grid)
    inner = None
    if seen is not None:  # and whose neighbours are seen, of which detail is made
        inner = scipy.ndimage.minimum_filter(seen.reshape(grid), 3, mode="nearest").ravel()
    scale = _over_strength(lacking.reshape(grid) ** 2, inner)
    patterns = np.stack([_detail(one / level, grid) for one in missing]) * scale
    return patterns @ patterns.T, patterns @ (lacking * scale)


def _detail(image: Floats, grid: tuple[int, int]) -> Floats:
    detail: Floats = scipy.ndimage.convolve(image.reshape(grid), _DETAIL, mode="nearest").ravel()
    return detail


def _over_strength(squares: Floats, seen: Bools | None) -> Floats:
    """One over the strength around each cell, (N,), of detail with these squares, (rows, cols); 0
    at cells that are not seen, and everywhere if there is no detail."""
    if seen is None:
        strength = scipy.ndimage.uniform_filter(squares, _AROUND).ravel()
        floor = _LEAST * float(strength.mean())
    else:
        known = seen.reshape(squares.shape).astype(np.float64)
        counted, total = (
            scipy.ndimage.uniform_filter(one, _AROUND).ravel() for one in (known, squares * known)
        )
        strength = np.divide(total, counted, out=np.zeros_like(total), where=seen)
        floor = _LEAST * float(strength[seen].mean()) if seen.any() else 0.0
    if not floor > _LEAST * _ROUNDING**2:
        return np.zeros_like(strength)
    scale = 1.0 / np.sqrt(np.maximum(strength, floor))
    return np.asarray(scale if seen is None else np.where(seen, scale, 0.0))


def _likeliest(precision: Floats, told: Floats, usual: Floats, sure: Floats) -> Floats:
    """The likeliest shares for these normal equations, with a normal prior (`usual`, `sure`)."""
    prior = sure**-2
    return np.asarray(np.linalg.solve(precision + np.diag(prior), told + usual * prior))
