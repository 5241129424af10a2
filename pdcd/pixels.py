"""Pictures of what two panels showed, refresh by refresh, each distinct picture kept once.

Codes repeat, blacks repeat: a run of thousands of refreshes has a few hundred distinct pictures. A
picture is a panel's pixels as sums of the three colour channels, 0..765, so that a pixel of a wrong
colour counts as the light it really gives; `FULL` is white.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError

FULL = 765
"""Level of a white pixel: three channels of 255."""

BLACK_PICTURE = -1
"""Index of a picture without any light; it is not stored."""

Box = tuple[int, int, int, int]
"""x, y, width, height in pixels."""

Picture = NDArray[np.uint16]


@dataclass(frozen=True)
class PanelPictures:
    """What one panel showed over F refreshes.

    size_px : (width, height)
    pictures : tuple of (height, width) uint16, 0..765; all different, none of them black.
    index : (F,) int32 into `pictures`; `BLACK_PICTURE` is black.
    """

    size_px: tuple[int, int]
    pictures: tuple[Picture, ...]
    index: NDArray[np.int32]

    def levels(self, index: int) -> NDArray[np.float64]:
        """Share of full light of every pixel, (height, width), of a picture or of black."""
        if index == BLACK_PICTURE:
            return np.zeros((self.size_px[1], self.size_px[0]))
        return self.pictures[index] / FULL


@dataclass(frozen=True)
class Shown:
    """What both panels showed, one picture each for every refresh of the frame log."""

    projector: PanelPictures
    mask: PanelPictures

    def __len__(self) -> int:
        return int(self.projector.index.size)


class Recorder:
    """Takes grabs of the whole screen in the order of the frame log, keeps what is new in them.

    `projector` and `mask` are the panels' places on the screen, as `Box`.
    """

    def __init__(self, projector: Box, mask: Box) -> None:
        self._panels = (_Panel(projector), _Panel(mask))

    def add(self, screen: NDArray[np.uint8]) -> None:
        """Keep one refresh; `screen` is (H, W, 3) uint8 RGB and may be used again afterwards."""
        for panel in self._panels:
            panel.add(screen)

    def repeat(self, times: int = 1) -> None:
        """The panels showed the last picture for further rows of the log, without a new grab."""
        for panel in self._panels:
            panel.index.extend(panel.index[-1:] * times)

    def shown(self) -> Shown:
        """Everything so far."""
        projector, mask = (panel.pictures() for panel in self._panels)
        return Shown(projector, mask)


def from_pictures(
    projector: Sequence[NDArray[np.uint8]], mask: Sequence[NDArray[np.uint8]]
) -> Shown:
    """Pictures made elsewhere: one (h, w) grey uint8 picture of each panel for each refresh.

    At least one refresh; raises ConfigError when the two have different numbers of refreshes.
    """
    if len(projector) != len(mask):
        raise ConfigError(
            f"{len(projector)} pictures of the projector and {len(mask)} of the mask",
            device="display",
            hint="one of each for every refresh",
        )
    panels = []
    for pictures in (projector, mask):
        height, width = pictures[0].shape
        panel = _Panel((0, 0, width, height))
        for picture in pictures:
            panel.keep(picture.astype(np.uint16) * 3)
        panels.append(panel.pictures())
    return Shown(panels[0], panels[1])


class _Panel:
    """The distinct pictures of one panel so far."""

    def __init__(self, box: Box) -> None:
        self._x, self._y, self._width, self._height = box
        self._known: dict[bytes, int] = {}
        self._kept: list[Picture] = []
        self.index: list[int] = []

    def add(self, screen: NDArray[np.uint8]) -> None:
        rows, columns = (
            slice(self._y, self._y + self._height),
            slice(self._x, self._x + self._width),
        )
        part = screen[rows, columns]
        if part.shape[:2] != (self._height, self._width):
            raise ConfigError(
                f"a grab of {screen.shape[1]} x {screen.shape[0]} pixels does not hold the panel",
                device="display",
                hint="has an output changed?",
            )
        self.keep(part.sum(axis=2, dtype=np.uint16))

    def keep(self, picture: Picture) -> None:
        if not picture.any():
            self.index.append(BLACK_PICTURE)
            return
        name = hashlib.blake2b(picture.tobytes(), digest_size=16).digest()
        if name not in self._known:
            self._known[name] = len(self._kept)
            self._kept.append(picture.copy())
        self.index.append(self._known[name])

    def pictures(self) -> PanelPictures:
        size = self._width, self._height
        return PanelPictures(size, tuple(self._kept), np.array(self.index, dtype=np.int32))
