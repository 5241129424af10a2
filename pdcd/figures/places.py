"""Measures pictures: their values at places of the field, and the share of one in another."""

from __future__ import annotations

import numpy as np

from pdcd.figures.figure import Image

_HALF = 0.012
"""Half a side of the patch that is averaged, as a share of the field's width."""


def average_patch(image: Image, at: tuple[float, float]) -> float:
    """Mean of green, or of grey, over a small patch around a point of the field."""
    height, width, colours = image.shape
    half = max(round(_HALF * width), 1)
    x, y = round(at[0] * width), round(at[1] * height)
    return float(np.nanmean(image[y - half : y + half + 1, x - half : x + half + 1, colours // 2]))


def fit_share(image: Image, of: Image) -> float:
    """The least-squares factor of a picture `of` in an image of its shape, where both are known."""
    known = np.isfinite(image) & np.isfinite(of)
    return float(image[known] @ of[known] / (of[known] @ of[known]))
