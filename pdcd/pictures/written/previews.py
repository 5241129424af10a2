"""Previews: all pictures of a run upright on the field, 8 bit, for people to look at.

All of a run have one white balance. Their brightness is that of the white photo, times a power of
two that each one states, so that light a hundred times weaker can be seen, and compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Bytes, Singles
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.upright import FieldSampler, FieldView, find_known_pixels
from pdcd.pictures.written.looks import Brightness, ToneStats, balance_of, compute_median_sigma
from pdcd.pictures.written.picture_files import draw_caption, write_png
from pdcd.sensor.bands import THREADS, fill_in_bands

LEAST_PX, MOST_PREVIEW_PX = 640, 1600
"""Width of a preview."""
_GAMMA = 2.2
HATCH = (44, 62)
"""Greys of the lines where nothing is known, and between them."""
_GREYS = (0.0, 0.125, 0.25, 0.5, 1.0)
"""Of the scale, linear."""
_SIGNED = (-1.0, -0.25, 0.0, 0.25, 1.0)
"""Of the scale of a signed picture."""

_CODES = np.rint(255.0 * np.linspace(0.0, 1.0, 65536) ** (1.0 / _GAMMA)).astype(np.uint8)


@dataclass(frozen=True)
class _Seen:
    """A picture on the field: (H, W, C) float32, where it is known, and its usual sigma."""

    image: Singles
    known: Bools
    sigma: float


class Previews:
    """The pictures of one run, ready to be drawn."""

    def __init__(self, pictures: Mapping[str, PictureWithErrors], view: FieldView) -> None:
        """pictures : by name, on the camera's quads, in scene units."""
        self._size_px = view.size_px(LEAST_PX, MOST_PREVIEW_PX)
        # Not finer than the camera sees: what is coarse is enlarged when it is drawn.
        sampler = FieldSampler(view, view.size_px(1, MOST_PREVIEW_PX))
        self._seen = {name: _seen(picture, sampler) for name, picture in pictures.items()}
        self.balance = balance_of(
            {name: (seen.image, seen.known) for name, seen in self._seen.items()}, view.white_patch
        )
        for seen in self._seen.values():
            seen.image[...] *= np.array(self.balance.factors, np.float32)
        self._brightness = Brightness(
            {n: ToneStats.of(s.image, s.known, s.sigma) for n, s in self._seen.items()}
        )
        self.warnings: tuple[str, ...] = ()
        if view.white_patch is not None and self.balance.source != "patch":
            x, y = view.white_patch
            self.warnings = (f"nothing can be seen of a white patch at {x:g} {y:g}",)

    def factor(self, name: str) -> float:
        """How much brighter a picture is drawn than the white one: a power of two."""
        return self._brightness.factor(name)

    def drawn(self, name: str) -> Bytes:
        """The preview of that name with its caption, (H, W, C) uint8."""
        seen, factor = self._seen[name], self.factor(name)
        scale = self._brightness.scale * factor
        shown, greys = (
            (encode_signed, _SIGNED) if self._brightness.signed(name) else (encode_gamma, _GREYS)
        )
        drawn = self._enlarged(shown(seen.image * np.float32(scale)), cv2.INTER_LINEAR)
        notes = [f"white balance: {self.balance.source}"] * (drawn.shape[2] > 1)
        if shown is encode_signed:
            notes.append("signed: middle grey is 0")
        if not seen.known.all():
            known = self._enlarged(seen.known.view(np.uint8), cv2.INTER_NEAREST)
            _hatch(drawn, known == 0)
            notes.append("hatched: not known")
        marks = [(int(shown(np.float32(g))), f"{g / scale:.2g}") for g in greys]
        title = f"{name}  x {factor:g}" if factor >= 1.0 else f"{name}  x 1/{1.0 / factor:g}"
        caption = draw_caption(drawn.shape[1], title, notes, marks)
        return np.concatenate([drawn, caption[..., : drawn.shape[2]]])

    def _enlarged(self, drawn: Bytes, how: int) -> Bytes:
        """What is smaller than a preview, as large as one."""
        if drawn.shape[1::-1] == self._size_px:
            return drawn
        large = np.asarray(cv2.resize(drawn, self._size_px, interpolation=how), dtype=np.uint8)
        return large.reshape(*large.shape[:2], *drawn.shape[2:])  # OpenCV drops an axis of one


def write_previews(
    folder: Path, pictures: Mapping[str, PictureWithErrors], view: FieldView
) -> tuple[str, ...]:
    """Write NAME.png of every picture into a folder; returns warnings.

    Raises NoSpaceError, or DiskError for any other refusal of the disk.
    """
    previews = Previews(pictures, view)
    with ThreadPoolExecutor(THREADS) as pool:
        for _ in pool.map(
            lambda name: write_png(folder / f"{name}.png", previews.drawn(name)), pictures
        ):
            pass
    return previews.warnings


def encode_gamma(linear: NDArray[np.float32] | np.float32) -> Bytes:
    """Linear values -> pixels of gamma 2.2, uint8; below 0 is black, above 1 white."""
    fine = np.clip(linear, 0.0, 1.0) * np.float32(65535.0)
    found: Bytes = _CODES[(fine + np.float32(0.5)).astype(np.uint16)]
    return found


def encode_signed(linear: NDArray[np.float32] | np.float32) -> Bytes:
    """The same around a middle grey that is 0: below it is darker, above brighter."""
    half = encode_gamma(np.abs(linear)).astype(np.int16) >> 1
    found: Bytes = np.where(np.asarray(linear) < 0.0, 127 - half, 128 + half).astype(np.uint8)
    return found


def _seen(picture: PictureWithErrors, sampler: FieldSampler) -> _Seen:
    known = fill_in_bands(
        picture.image.shape[:2],
        np.bool_,
        lambda rows: find_known_pixels(picture.sigma[rows], picture.image[rows]),
    )
    image, seen = sampler(picture.image, known)
    return _Seen(image, seen, compute_median_sigma(picture.sigma, known))


def _hatch(drawn: Bytes, where: Bools) -> None:
    """Mark pixels of a picture (H, W, C) as not known, by quiet diagonal lines."""
    down, right = np.nonzero(where)
    drawn[down, right] = np.where((down + right) % 8 < 2, *HATCH[::-1])[:, None]
