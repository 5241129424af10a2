"""What both panels show in one photo of a calibration: pictures of their own pixels.

Calibration does not know yet where the panels lie, so its patterns have no cells: a pattern is an
image of one panel, one value for each of its pixels. Grey is made over time: several refreshes,
each of them black and white. Patterns have grey levels only where these are themselves measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.frames import BLACK, PIXEL_WINDOW, WHITE, Frames
from pdcd.panels.patterns import Patterns, make_empty_patterns, pack_bits

Bits = NDArray[np.bool_]
_Levels = NDArray[np.uint8]
PanelName = Literal["projector", "mask"]
NO_PATTERNS: Bits = np.zeros((0, 0, 0), np.bool_)
"""Of a panel that is black or white throughout."""


@dataclass(frozen=True, eq=False)
class PanelSequence:
    """One photo.

    name : of the photo, unique within its step: "dots-projector".
    projector, mask : (P, height, width) and (M, height, width) bool, patterns of the panel's own
        pixels: row 0 is at the top, True is lit, or open; or uint8, 255 is full light. Empty where
        the panel needs none.
    projector_index, mask_index : (F,) int32, which pattern each refresh shows; `BLACK` and `WHITE`
        are negative. The panels are black before and after.
    """

    name: str
    projector: Bits | _Levels
    mask: Bits | _Levels
    projector_index: NDArray[np.int32]
    mask_index: NDArray[np.int32]

    def __post_init__(self) -> None:
        if self.projector_index.shape != self.mask_index.shape:
            raise ValueError(f"{self.name}: both panels need as many refreshes")
        for index, patterns in (
            (self.projector_index, self.projector),
            (self.mask_index, self.mask),
        ):
            if index.size and (index.min() < WHITE or index.max() >= len(patterns)):
                raise ValueError(f"{self.name}: a refresh shows a pattern that is not there")

    @property
    def refreshes(self) -> int:
        """How many refreshes it lasts."""
        return int(self.projector_index.size)


def make_still_sequence(
    name: str,
    refreshes: int,
    projector: Bits | _Levels | int = BLACK,
    mask: Bits | _Levels | int = BLACK,
) -> PanelSequence:
    """A photo in which nothing changes. Each panel shows one pattern (height, width), or `BLACK` or
    `WHITE`."""
    first, second = (
        NO_PATTERNS if isinstance(panel, int) else panel[None] for panel in (projector, mask)
    )
    rows = [
        np.full(refreshes, panel if isinstance(panel, int) else 0, dtype=np.int32)
        for panel in (projector, mask)
    ]
    return PanelSequence(name, first, second, rows[0], rows[1])


def make_sole_sequence(
    name: str, refreshes: int, panel: PanelName, picture: Bits | _Levels | int
) -> PanelSequence:
    """A photo in which one panel shows a picture, as for `make_still_sequence`, and the other lets
    all light pass."""
    both = (picture, WHITE) if panel == "projector" else (WHITE, picture)
    return make_still_sequence(name, refreshes, *both)


def pack_frames(shown: PanelSequence) -> Frames:
    """The photo as a display takes it: patterns of pixels, packed."""
    refreshes = shown.refreshes
    return Frames(
        _packed(shown.projector),
        _packed(shown.mask),
        shown.projector_index.astype(np.int32),
        shown.mask_index.astype(np.int32),
        np.zeros(refreshes, dtype=np.uint8),
        np.arange(refreshes, dtype=np.int32),
        shown.mask_index == BLACK,
        (1, 1),
        (1, 1),
        PIXEL_WINDOW,
    )


def _packed(patterns: Bits | _Levels) -> Patterns:
    if not len(patterns):
        return make_empty_patterns()
    flat = patterns.reshape(len(patterns), -1)
    if flat.dtype == np.bool_:
        return pack_bits(flat.astype(np.bool_))
    return np.asarray(flat / 255.0, np.float32)
