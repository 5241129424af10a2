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

CAPTION_SHARES = (48 / 512, 50 / 512, 10 / 512)
"""Height of a strip, width of one grey of its scale, and its margin, over its width: letters grow
with the picture, which is shrunk to where it is looked at."""
PAPER, _INK, _FAINT = 24, 225, 165
"""Greys of the strip and its letters."""
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_TITLE, _NOTES, _MARKS, _LEAST = 0.6 / 512, 0.44 / 512, 0.42 / 512, 0.3 / 512
"""Sizes of letters, and of those that are shrunk to fit, over the width."""


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
    width_px: int,
    title: str,
    notes: Sequence[str],
    greys: Sequence[tuple[int, str]],
    times: float = 1.0,
) -> Bytes:
    """A caption, (`CAPTION_SHARES[0]` of `times * width_px`, width_px, 3) uint8.

    title, notes : ASCII; the notes are smaller, below the title, apart from each other. Both are
    shrunk to fit beside the scale.
    greys : pixel values from dark to bright, and what is written below each.
    times : larger than usual, for pictures that stand several to a row.
    """
    large_px = times * width_px
    height_px, step_px, margin_px = (round(share * large_px) for share in CAPTION_SHARES)
    drawn = np.full((height_px, width_px), PAPER, np.uint8)
    left = width_px - margin_px - step_px * len(greys)
    base, middle = round(0.83 * height_px), round(0.45 * height_px)
    for number, (grey, words) in enumerate(greys):
        begin = left + number * step_px
        drawn[height_px // 8 : height_px * 13 // 24, begin : begin + step_px] = grey
        size, across = _fit(words, step_px, _MARKS * large_px)
        _write(drawn, words, (begin + (step_px - across) // 2, base), size, _FAINT)
    room = drawn[:, : left - margin_px]  # what does not fit must not run into the scale
    for words, share, at, grey in (
        (title, _TITLE, middle, _INK),
        ("   ".join(notes), _NOTES, base, _FAINT),
    ):
        size, _ = _fit(words, room.shape[1] - margin_px, share * large_px)
        _write(room, words, (margin_px, at), max(size, _LEAST * large_px), grey)
    return np.repeat(drawn[..., None], 3, axis=2)


def _fit(words: str, room_px: int, size: float) -> tuple[float, int]:
    """Size of letters, no larger than that, for which words fit; and how wide they are then."""
    (across, _), _ = cv2.getTextSize(words, _FONT, size, 1)
    if across <= room_px or room_px <= 0:
        return size, across
    return size * room_px / across, room_px


def _write(on: Bytes, words: str, at: tuple[int, int], size: float, grey: int) -> None:
    cv2.putText(on, words, at, _FONT, size, grey, max(round(size), 1), cv2.LINE_AA)
