"""The flat field: how unevenly the light of a white projector comes from a white card.

A smooth surface, Legendre polynomials up to a total order, is fitted to means of blocks by
reweighting (Tukey's biweight), so that dust does not bend it. What is left beyond 0.3 % is dust;
where much is left there is no card, but a scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.photo import Photo, block_means, refuse_clipped, refuse_dark
from pdcd.errors import CalibrationError

Floats = NDArray[np.float64]
Marks = NDArray[np.bool_]

SIDE = 8
ORDER = 8
"""Of x and y together: 45 polynomials, for vignetting and the projector's own fall-off."""
LIT = 0.2
"""Blocks with less of the brightest ones' light are beyond the picture's edge."""
LEAST_BLOCKS = 200
ALIKE = 0.9
"""Of its inner neighbour's light, that a block at the photo's border has in the picture."""
DUST = 0.003
CLEAR = 1.0 - DUST
"""Of the light to be expected there, that a side of the photo has in the picture."""
TEXTURE = 0.01
TEXTURE_SHARE = 0.1
"""Share of blocks off by 1 % from which there is no card."""
SIGMAS = 5.0
ROUNDS = 8
BIWEIGHT = 4.685
"""Tukey's constant, in standard deviations."""
UNEVEN = (0.5, 0.2)
"""Least light over that in the middle: good, and bad below."""


@dataclass(frozen=True, eq=False)
class Flat:
    """The flat field of one photo.

    coefficients : (3, polynomials) of R, G, B, in the order of `_columns`; 1 in the middle.
    shape : (h, w) quads of the photo.
    lit : (rows, cols) blocks of 8 quads that hold light.
    residual : (rows, cols) mean over the channels of light over the surface, less 1; 0 in the dark,
        and where the picture's blurred edge runs along the photo's.
    dust : (rows, cols) blocks where that is no noise and more than 0.3 %.
    """

    coefficients: Floats
    shape: tuple[int, int]
    lit: Marks
    residual: Floats
    dust: Marks

    def rows(self, first: int, last: int) -> Floats:
        """The surface at the centres of quads of some rows, (last - first, w, 3)."""
        height, width = self.shape
        y, x = np.arange(first, last) + 0.5, np.arange(width) + 0.5
        columns = _columns(2.0 * x / width - 1.0, 2.0 * y / height - 1.0)
        return np.asarray(np.moveaxis(np.tensordot(self.coefficients, columns, 1), 0, -1))

    @property
    def least(self) -> float:
        """Least light of the surface in the lit part."""
        rows, cols = self.lit.shape
        y, x = (2.0 * (np.arange(n) + 0.5) / n - 1.0 for n in (rows, cols))
        surface = np.tensordot(self.coefficients, _columns(x, y), 1)
        return float(surface[:, self.lit].min())

    def figures(self) -> tuple[Figure, ...]:
        """What to tell of it."""
        least, dust = self.least, float(self.dust[self.lit].mean())
        verdict = Verdict.GOOD if least >= UNEVEN[0] else Verdict.DOUBTFUL
        if least < UNEVEN[1]:
            verdict = Verdict.BAD
        clean = Verdict.GOOD if dust < 0.01 else Verdict.DOUBTFUL
        noise = float(np.std(self.residual[self.lit & ~self.dust]))
        return (
            Figure("light.flat_least", least, noise, "", f"{UNEVEN[0]:g} or more", verdict),
            Figure("light.dust_share", dust, 0.0, "", "below 0.01", clean),
        )


def flat_of(white: Photo, without: Floats | None = None) -> Flat:
    """Fit the flat field of a white card.

    Parameters
    ----------
    white : projector white, mask open, on the card.
    without : (h, w, 3), the light of the same photo with the projector black.

    Raises CalibrationError: no light, saturated, a card that fills too little, or no card at all.
    """
    refuse_clipped("WW", white, "close the aperture, or show fewer refreshes")
    light = block_means(white.light if without is None else white.light - without, SIDE)
    sigma = np.sqrt(block_means(white.variance, SIDE)) / SIDE
    high = float(np.quantile(light.sum(axis=2), 0.98))
    refuse_dark({"WW": high}, 8.0 * float(np.median(sigma)))
    lit = binary_erosion(light.sum(axis=2) > LIT * high, iterations=1, border_value=1)
    _cut_borders(lit, light.sum(axis=2))
    if lit.sum() < LEAST_BLOCKS:
        raise CalibrationError(
            f"only {int(lit.sum())} blocks of 8 quads hold light",
            device="camera",
            hint="a card must fill the field",
        )
    told = _without_blurred(lit, light.sum(axis=2))
    rows, cols = lit.shape
    y, x = ((np.arange(n) + 0.5) * SIDE for n in (rows, cols))
    height, width = white.light.shape[:2]
    columns = _columns(2.0 * x / width - 1.0, 2.0 * y / height - 1.0)[:, told].T
    fits, away, noise = [], np.zeros((3, int(told.sum()))), np.zeros(int(told.sum()))
    for channel in range(3):
        fit = _robust(columns, light[told][:, channel], sigma[told][:, channel])
        surface = columns @ fit
        if surface.min() <= 0.0:
            raise _no_card("a smooth surface cannot follow the light")
        away[channel] = light[told][:, channel] / surface - 1.0
        noise += (sigma[told][:, channel] / surface) ** 2 / 9.0
        fits.append(fit)
    residual, dust = np.zeros(lit.shape), np.zeros(lit.shape, np.bool_)
    residual[told] = away.mean(axis=0)
    limit = SIGMAS * np.sqrt(noise)
    off = float(np.mean(np.abs(residual[told]) > np.maximum(TEXTURE, limit)))
    if off > TEXTURE_SHARE:
        raise _no_card(f"{100.0 * off:.0f} % of the picture is off a smooth surface by 1 %")
    dust[told] = np.abs(residual[told]) > np.maximum(DUST, limit)
    middle = _columns(np.array([0.0]), np.array([0.0]))[:, 0, 0]
    coefficients = np.array(fits)
    return Flat(
        coefficients / (coefficients @ middle)[:, None], (height, width), lit, residual, dust
    )


def _cut_borders(lit: Marks, light: Floats) -> None:
    """Take blocks out of `lit` through which both the picture's edge and the photo's run."""
    for marks, values in ((lit, light), (lit.T, light.T)):
        for border, inner in ((0, 1), (-1, -2)):
            marks[border] &= values[border] >= ALIKE * values[inner]


def _without_blurred(lit: Marks, light: Floats) -> Marks:
    """`lit` without sides of the photo that are darker than a parabola through the next three
    blocks has them: there the picture ends, and the camera's blur meets darkness. A speck lies on
    no whole side."""
    told = lit.copy()
    for marks, values in ((told, light), (told.T, light.T)):
        for border, *inner in ((0, 1, 2, 3), (-1, -2, -3, -4)):
            side = marks[border] & marks[inner].all(axis=0)
            one, two, three = (values[k][side] for k in inner)
            if side.any() and np.median(values[border][side] / (3 * one - 3 * two + three)) < CLEAR:
                marks[border] = False
    return told


def _columns(x: Floats, y: Floats) -> Floats:
    """Products of Legendre polynomials of x and y, (polynomials, y, x)."""
    across, down = legendre.legvander(x, ORDER), legendre.legvander(y, ORDER)
    return np.array(
        [np.outer(down[:, j], across[:, i]) for i in range(ORDER + 1) for j in range(ORDER + 1 - i)]
    )


def _robust(columns: Floats, values: Floats, sigma: Floats) -> Floats:
    """Coefficients by reweighted least squares."""
    weights = 1.0 / np.maximum(sigma, 1e-9)
    keep = np.ones_like(values)
    fit: Floats = np.zeros(columns.shape[1])
    for _ in range(ROUNDS):
        w = weights * np.sqrt(keep)
        fit = np.linalg.lstsq(columns * w[:, None], values * w, rcond=1e-10)[0].astype(np.float64)
        away = (values - columns @ fit) * weights
        spread = 1.4826 * float(np.median(np.abs(away)))
        keep = np.clip(1.0 - (away / (BIWEIGHT * max(spread, 1e-9))) ** 2, 0.0, 1.0) ** 2
    return fit


def _no_card(why: str) -> CalibrationError:
    return CalibrationError(
        f"no even card stands before the camera: {why}",
        device="camera",
        hint="put a white matt card into the scene's plane; where stripes of the mask's pixels "
        "show, defocus the camera a little",
    )
