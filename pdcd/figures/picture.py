"""From linear light to the PNG files of a page: one scale of brightness a row, a labelled strip."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.figures.figure import Panel, Row
from pdcd.pictures.written.looks import LEVEL, LEVEL_PERCENT
from pdcd.pictures.written.picture_files import strip
from pdcd.pictures.written.previews import coded

Bytes = NDArray[np.uint8]

LEAST_PX = 480
"""Width of a picture, at least: what is narrower is enlarged, so that its strip can be read."""
STRIP_PX = 600
"""Width of picture from which on the strip grows with it."""
SHOWN = (0.0, 0.25, 1.0)
"""Of the scale of greys, linear."""
RIM = 0.008
"""Share of the width that is cut off at each side."""
UNKNOWN = 60
"""Grey of what no quad of the camera shows."""


def drawn(row: Row) -> list[Bytes]:
    """All panels of a row as they are to be seen, (H, W, 3) uint8 each, with their strips."""
    usual = white_of(row.panels[0].image) or 1.0
    return [_panel(panel, panel.white or usual) for panel in row.panels]


def white_of(image: NDArray[Any]) -> float:
    """Scene units that are shown as white, so that the brightest hundredth of a picture gets to
    `LEVEL` or more; 0 for one without light."""
    known = image[np.isfinite(image)]
    return float(np.percentile(np.abs(known), LEVEL_PERCENT)) / LEVEL if known.size else 0.0


def _panel(panel: Panel, white: float) -> Bytes:
    if panel.kind == "grey":
        pixels = np.asarray(panel.image, np.uint8)
        pixels = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)
        return _with_strip(_enlarged(pixels, cv2.INTER_NEAREST), panel.caption, ())
    image = _cropped(np.asarray(panel.image, np.float32))
    image = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    known = np.isfinite(image).all(axis=-1)
    linear = np.nan_to_num(image) / np.float32(white)
    if panel.signed:
        # 0 as middle grey: linear about it, for a gamma would bend both signs unlike.
        pixels = np.rint(255.0 * np.clip(0.5 + 0.5 * linear, 0.0, 1.0)).astype(np.uint8)
        marks = tuple((round(255 * (0.5 + 0.5 * g)), f"{g * white:.2g}") for g in (-1.0, 0.0, 1.0))
    else:
        pixels = coded(linear)
        marks = tuple((int(coded(np.float32(g))), f"{g * white:.2g}") for g in SHOWN)
    pixels[~known] = UNKNOWN
    return _with_strip(_enlarged(pixels, cv2.INTER_CUBIC), panel.caption, marks)


def _cropped(image: NDArray[Any]) -> NDArray[Any]:
    """Without the rim, of which quads see only a part."""
    rim = max(round(RIM * image.shape[1]), 1)
    return image[rim:-rim, rim:-rim]


def _enlarged(pixels: Bytes, how: int) -> Bytes:
    height, width = pixels.shape[:2]
    if width >= LEAST_PX:
        return pixels
    if how == cv2.INTER_NEAREST:  # whole factors, so that all squares are alike
        factor = -(-LEAST_PX // width)
        size = width * factor, height * factor
    else:
        size = LEAST_PX, round(height * LEAST_PX / width)
    return np.asarray(cv2.resize(pixels, size, interpolation=how), np.uint8)


def _with_strip(pixels: Bytes, caption: str, marks: tuple[tuple[int, str], ...]) -> Bytes:
    plain = caption.encode("ascii", "replace").decode()
    notes = ["scene units"] if marks else [""]
    width = pixels.shape[1]
    times = max(round(width / STRIP_PX), 1)  # so that it can be read where the picture is shrunk
    below = strip(-(-width // times), plain, notes, marks)
    below = below.repeat(times, axis=0).repeat(times, axis=1)[:, :width]
    return np.concatenate([pixels, below])
