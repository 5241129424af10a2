"""Pictures of what two panels showed, refresh by refresh, each distinct picture kept once.

Codes repeat, blacks repeat: a run of thousands of refreshes has a few hundred distinct pictures. A
picture is a panel's pixels as sums of the three colour channels, 0..765, so that a pixel of a wrong
colour counts with the light that it really gives; `WHITE_SUM` is white.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError

WHITE_SUM = 765
"""Level of a white pixel: three channels of 255."""

BLACK_PICTURE = -1
"""Index of a picture without any light; it is not stored."""

PanelBox = tuple[int, int, int, int]
"""x, y, width, height in pixels."""

PanelImage = NDArray[np.uint16]


@dataclass(frozen=True)
class PanelPictures:
    """What one panel showed over F refreshes.

    size_px : (width, height)
    pictures : tuple of (height, width) uint16, 0..765; all different, none of them black.
    index : (F,) int32 into `pictures`; `BLACK_PICTURE` is black.
    """

    size_px: tuple[int, int]
    pictures: tuple[PanelImage, ...]
    index: NDArray[np.int32]

    def levels(self, index: int) -> NDArray[np.float64]:
        """Share of full light of every pixel, (height, width), of a picture or of black."""
        if index == BLACK_PICTURE:
            return np.zeros((self.size_px[1], self.size_px[0]))
        return self.pictures[index] / WHITE_SUM


@dataclass(frozen=True)
class ShownPictures:
    """What both panels showed, one picture each for every refresh of the frame log."""

    projector: PanelPictures
    mask: PanelPictures

    def __len__(self) -> int:
        return int(self.projector.index.size)


def crop_panel(screen: NDArray[np.uint8], box: PanelBox) -> PanelImage:
    """One panel, cut from a grab of the screen, (H, W, 3) uint8.

    Raises ConfigError when the grab does not contain the panel.
    """
    x, y, width, height = box
    part = screen[y : y + height, x : x + width]
    if part.shape[:2] != (height, width):
        raise ConfigError(
            f"a grab of {screen.shape[1]} x {screen.shape[0]} pixels does not hold the panel",
            device="display",
            hint="has an output changed?",
        )
    return np.asarray(part.sum(axis=2, dtype=np.uint16))


class Recorder:
    """Takes pictures of both panels in the order of the frame log, and keeps the new ones."""

    def __init__(self, projector_px: tuple[int, int], mask_px: tuple[int, int]) -> None:
        self._panels = (_Panel(projector_px), _Panel(mask_px))

    def add(self, projector: PanelImage, mask: PanelImage) -> None:
        """Keep one refresh; the arrays may be used again afterwards."""
        for panel, shown in zip(self._panels, (projector, mask), strict=True):
            panel.add(shown)

    def black(self) -> None:
        """Both panels were black for one row of the log, without a picture of it."""
        for panel in self._panels:
            panel.index.append(BLACK_PICTURE)

    def shown(self) -> ShownPictures:
        """Everything so far."""
        projector, mask = (panel.pictures() for panel in self._panels)
        return ShownPictures(projector, mask)


class _Panel:
    """The distinct pictures of one panel so far."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self._size_px = size_px
        self._known: dict[bytes, int] = {}
        self._kept: list[PanelImage] = []
        self.index: list[int] = []

    def add(self, shown: PanelImage) -> None:
        if not shown.any():
            self.index.append(BLACK_PICTURE)
            return
        name = hashlib.blake2b(shown.tobytes(), digest_size=16).digest()
        if name not in self._known:
            self._known[name] = len(self._kept)
            self._kept.append(shown.copy())
        self.index.append(self._known[name])

    def pictures(self) -> PanelPictures:
        return PanelPictures(self._size_px, tuple(self._kept), np.array(self.index, dtype=np.int32))
