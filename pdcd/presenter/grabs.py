"""The display process looks at its own pixels, refresh by refresh: option `grab_px`.

For tests of the whole chain: a wrong pixel, exchanged panels, a mirrored or shifted window then
show in the photo of a virtual camera. Takes about 2 ms a refresh at a quarter of full size. At full
size it takes longer than a refresh, so that every one of them counts as missed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.panels.pixels import Box, Picture, picture
from pdcd.presenter.xgrab import RootGrabber

PICTURES = ("projector_pictures", "mask_pictures")
"""Names of the shared arrays, (refreshes, height, width) uint16: sums of the colour channels."""

MOST_BYTES = 2**31
"""A longer run than this many bytes of pictures is refused."""


def room(count: int, sizes_px: tuple[tuple[int, int], tuple[int, int]]) -> dict[str, Picture]:
    """Empty arrays for the pictures of `count` refreshes of panels (width, height).

    Raises ConfigError when they would be too large.
    """
    size = sum(2 * count * width * height for width, height in sizes_px)
    if size > MOST_BYTES:
        raise ConfigError(
            f"pictures of {count} refreshes would take {size / 2**30:.1f} GiB",
            device="display",
            hint="grab_px is for short tests: fewer codes, smaller panels, or leave it out",
        )
    return {
        name: np.zeros((count, height, width), dtype=np.uint16)
        for name, (width, height) in zip(PICTURES, sizes_px, strict=True)
    }


class Grabs:
    """Pictures of both panels, taken by the display process after each refresh.

    `boxes` are where the virtual bench has its panels, whatever the windows' places are: a panel
    that is shown elsewhere is then seen as what it is. `settle` returns once the server has taken
    what was swapped.
    """

    def __init__(self, name: str, boxes: tuple[Box, Box], settle: Callable[[], None]) -> None:
        self._grabber = RootGrabber(name)
        self._boxes = boxes
        self._settle = settle
        self._into: list[NDArray[Any]] = []

    def begin(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take over the arrays of the coming pass."""
        self._into = [arrays[name] for name in PICTURES if name in arrays]

    def take(self, number: int) -> None:
        """Look at the screen: this is what refresh `number` shows."""
        if not self._into:
            return
        self._settle()
        screen = self._grabber.grab()
        for out, box in zip(self._into, self._boxes, strict=True):
            out[number] = picture(screen, box)
