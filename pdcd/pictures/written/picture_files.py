"""Pictures as files, and the strip below one: its name, notes, and a scale of greys."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bytes
from pdcd.errors import ConfigError, DecodeError, disk_errors
from pdcd.files.images import encode_png, make_tiff_ends
from pdcd.files.reading import MAX_PICTURE_BYTES, read_file, refuse_unsound

HEIGHT_PX = 48
PAPER, _INK, _FAINT = 24, 225, 150
"""Greys of the strip and its letters."""
STEP_PX, _STEP_HEIGHT_PX = 52, 20
"""Size of one grey of the scale."""
_FONT = cv2.FONT_HERSHEY_SIMPLEX
MARGIN_PX = 10


def draw_value_table(grey: NDArray[np.float64], min_width_px: int = 640) -> NDArray[np.uint8]:
    """A table of numbers to look at, (H, W, 3) uint8, each a square.

    grey : (h, w), 0 is black and 1 is white, linear; what lies beyond is cut off, NaN is black.
    min_width_px : a narrower table is enlarged by a whole factor.
    """
    linear = np.clip(np.nan_to_num(grey, nan=0.0), 0.0, 1.0)
    picture = np.rint(255.0 * linear).astype(np.uint8)[..., None].repeat(3, axis=2)
    factor = max(-(-min_width_px // picture.shape[1]), 1)
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write an (H, W, 3) uint8 RGB picture, or a grey (H, W, 1) one, as PNG. Raises
    `NoSpaceError`, or `PdcdError` for any other refusal of the disk."""
    _check(path, picture)
    # Encoded in memory and written here, as cv2.imwrite reports a full disk only as False.
    data = encode_png(picture)
    with disk_errors(str(path)):
        path.write_bytes(data)


def write_tiff(path: Path, image: NDArray[np.floating]) -> None:
    """Write an (h, w, 3) RGB image, or a grey (h, w, 1) one, as uncompressed float32 TIFF: float32
    values, negative and NaN ones too, come back exactly. Raises `NoSpaceError`, or
    `PdcdError` for any other refusal of the disk."""
    _check(path, image)
    singles = np.ascontiguousarray(image, dtype="<f4")
    before, after = make_tiff_ends(singles)
    with disk_errors(str(path)), path.open("wb") as file:
        file.write(before)
        file.write(singles.data)
        file.write(after)


def read_tiff(path: Path) -> NDArray[np.float32]:
    """Read what `write_tiff` wrote, as (h, w, 3) float32 RGB, or (h, w, 1) grey. Raises
    `DecodeError`."""
    try:
        with refuse_unsound(path):
            data = np.frombuffer(read_file(path, MAX_PICTURE_BYTES), dtype=np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error as err:  # an empty file, or a size beyond OpenCV's limits
        raise DecodeError(f"cannot decode {path.name}: {err.err}") from err
    if image is not None and image.ndim == 2:
        image = image[..., None]
    if image is None or image.dtype != np.float32 or image.shape[2:] not in ((1,), (3,)):
        raise DecodeError(
            f"{path.name} is not a whole float32 RGB or grey TIFF", hint="develop the run again"
        )
    return np.asarray(image[..., ::-1], dtype=np.float32).copy()


def _check(path: Path, rgb: NDArray[np.generic]) -> None:
    if rgb.shape[2:] not in ((1,), (3,)) or not rgb.size:
        raise ConfigError(f"{path.name}: an image needs shape (h, w, 3 or 1), not {rgb.shape}")


def draw_caption(
    width_px: int, title: str, notes: Sequence[str], greys: Sequence[tuple[int, str]]
) -> Bytes:
    """A caption, (HEIGHT_PX, width_px, 3) uint8.

    title, notes : ASCII; the notes are smaller, below the title, apart from each other.
    greys : pixel values from dark to bright, and what is written below each.
    """
    drawn = np.full((HEIGHT_PX, width_px), PAPER, np.uint8)
    left = width_px - MARGIN_PX - STEP_PX * len(greys)
    for number, (grey, words) in enumerate(greys):
        begin = left + number * STEP_PX
        drawn[6 : 6 + _STEP_HEIGHT_PX, begin : begin + STEP_PX] = grey
        (across, _), _ = cv2.getTextSize(words, _FONT, 0.38, 1)
        _write(drawn, words, (begin + (STEP_PX - across) // 2, HEIGHT_PX - 8), 0.38, _FAINT)
    room = drawn[:, : left - MARGIN_PX]  # what does not fit must not run into the scale
    _write(room, title, (MARGIN_PX, 21), 0.6, _INK)
    _write(room, "   ".join(notes), (MARGIN_PX, HEIGHT_PX - 9), 0.4, _FAINT)
    return np.repeat(drawn[..., None], 3, axis=2)


def _write(on: Bytes, words: str, at: tuple[int, int], size: float, grey: int) -> None:
    cv2.putText(on, words, at, _FONT, size, grey, 1, cv2.LINE_AA)
