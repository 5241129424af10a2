"""How much smooth light of each kind a photo holds, by what it gets wrong of it.

What the codes get wrong of smooth light is a known pattern for each kind of it
(`pdcd.pictures.smooth`), which changes from cell to cell like noise. As much of each as is found in
the fine detail of the image, weighed against the chance that it is texture, is in the photo.
Textured surfaces hide the patterns: then little is learnt. Parts of a photo get other amounts
wrong, and what they differ by holds no texture.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats

_DETAIL = np.array([[-1.0, 2.0, -1.0], [2.0, -4.0, 2.0], [-1.0, 2.0, -1.0]]) / 4.0
"""Keeps what changes from cell to cell, and nothing of a plane."""
_AROUND = 5
"""Side, in cells, of the square over which the strength of detail is averaged."""
_DARK = 0.01
"""Share of the mean light that all cells are taken to have beside their own."""
_LEAST = 1e-6
"""Least strength of detail, over its mean: cells without light tell nothing."""
_ROUNDING = 1e-12
"""Detail that weak, relative to the light, is none: of a grid of one row or column nothing else is
left of it."""
_LESS_SURE = 4.0
"""How many times further shares may be from the usual ones where parts tell."""
FROM, TO = -1.0, 2.0
"""Shares are within, where parts tell. What the model has too much of one kind of light may be made
up for by another."""
_ROUNDS = 2
"""How often the strength of what the shares leave is looked at."""


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
    light. usual, sure : (P,), mean and standard deviation of shares before anything is told. seen :
    (N,), cells whose light is known, None for all.
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
    """Shares from `FROM` to `TO`, (P,), by the detail of an image and by what its parts differ by.

    lacking : of each part, (N,), what it lacks of the whole, times its weight over that of the
    whole. patterns : of each, (P, N), what it would lack of it of each kind of light, times the
    same. Others as of `fit_shares_to_detail`.
    """
    level = light + _DARK * light.mean()
    wrong = np.stack(lacking) / level  # (B, N)
    known = np.stack(patterns, axis=1) / level  # (P, B, N)
    precision, told = _by_detail(light, missing, grid, seen)
    shares = usual
    for _ in range(_ROUNDS):
        # What the shares leave is noise, and light that no pattern has.
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
    """What the detail of an image tells of shares: their precision, (P, P), and that times the
    shares, (P,). Detail is taken as normal with the strength it has around each cell."""
    # Relative to the light of each cell: a surface that is twice as bright shows twice the pattern,
    # and its texture must not be taken for one.
    level = light + _DARK * light.mean()
    lacking = -_detail(np.log(level), grid)
    inner = None
    if seen is not None:  # with all that the detail is made of
        inner = scipy.ndimage.minimum_filter(seen.reshape(grid), 3, mode="nearest").ravel()
    scale = _over_strength(lacking.reshape(grid) ** 2, inner)
    patterns = np.stack([_detail(one / level, grid) for one in missing]) * scale
    return patterns @ patterns.T, patterns @ (lacking * scale)


def _detail(image: Floats, grid: tuple[int, int]) -> Floats:
    detail: Floats = scipy.ndimage.convolve(image.reshape(grid), _DETAIL, mode="nearest").ravel()
    return detail


def _over_strength(squares: Floats, seen: Bools | None) -> Floats:
    """One over the strength around each cell, (N,), of what has these squares, (rows, cols); 0 of
    cells that are not seen, and everywhere where there is none."""
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
    """The likeliest shares for what was told, where they are normal with `usual` and `sure`."""
    prior = sure**-2
    return np.asarray(np.linalg.solve(precision + np.diag(prior), told + usual * prior))
