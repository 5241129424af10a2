"""Dots that a panel shows on a card: three photos show where each of its pixels lies.

The photos are white, black and dots. Dots lie on a square lattice. The white picture has black
holes midway between four dots, at about every second such place, by a code of the panel's own. Any
part of the code of some hundred places is unique, also when turned or mirrored. So the photos need
no prior map, and one panel is not taken for the other. The holes lie where the picture of dots is
black, so they cost the dots nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.shown import Bits, PanelName, PanelSequence, make_sole_sequence
from pdcd.errors import CalibrationError
from pdcd.panels.blocks import hash_to_bits
from pdcd.panels.frames import BLACK

_USUAL_PITCH_PX: dict[PanelName, int] = {"projector": 32, "mask": 40}
_LEAST_COLUMNS = 16
"""Dots in a row of a small panel, at least."""
_LEAST_ROWS, _LEAST_PITCH_PX = 4, 8
"""Rows of dots on any panel, and pixels from one dot to the next."""
PER_RADIUS = 5
"""Pitch over radius: neighbours' blurred edges stay apart, and holes fit between."""


@dataclass(frozen=True)
class DotGrid:
    """The dots of one panel.

    size_px : (width, height) of the panel; pitch_px, radius_px : of the dots, whose pitch is four
        radii or more.
    """

    panel: PanelName
    size_px: tuple[int, int]
    pitch_px: int
    radius_px: float

    @classmethod
    def usual(cls, panel: PanelName, size_px: tuple[int, int]) -> DotGrid:
        """Pitch 32 on the projector, 40 on the mask; closer on small panels.

        Raises CalibrationError for a panel that has too few pixels for dots.
        """
        pitch = min(_USUAL_PITCH_PX[panel], 2 * (size_px[0] // (2 * _LEAST_COLUMNS)))
        if pitch < _LEAST_PITCH_PX or size_px[1] < _LEAST_ROWS * pitch:
            width, height = (
                _LEAST_COLUMNS * _LEAST_PITCH_PX,
                _LEAST_ROWS * max(pitch, _LEAST_PITCH_PX),
            )
            raise CalibrationError(
                f"{size_px[0]} x {size_px[1]} pixels of the {panel} are too few for its dots",
                device=panel,
                hint=f"{width} x {height} are needed; for a mock bench, set {panel}.size_px",
            )
        return cls(panel, size_px, pitch, float(round(pitch / PER_RADIUS)))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of dots."""
        return self.size_px[1] // self.pitch_px, self.size_px[0] // self.pitch_px

    def centres(self, index: NDArray[np.int64]) -> Floats:
        """Centres in panel pixels, (n, 2), of dots (column, row), (n, 2).

        They lie on corners or on centres of pixels, so that a disc's pixels are even about them.
        """
        rows, cols = self.shape
        spare = np.array(self.size_px) - self.pitch_px * np.array([cols, rows])
        found: Floats = 0.5 * (spare + self.pitch_px) + self.pitch_px * index
        return found

    def dots(self) -> Bits:
        """The picture of dots, (height, width) bool."""
        rows, cols = self.shape
        return self._discs(np.ones((rows, cols), dtype=np.bool_), 0.0)

    def white(self) -> Bits:
        """The white picture, with its holes, (height, width) bool."""
        return ~self._discs(self.holes(), 0.5)

    def holes(self) -> Bits:
        """The code, (rows - 1, columns - 1) bool: [j, i] is whether there is a hole amid the dots
        (i, j) to (i + 1, j + 1)."""
        rows, cols = self.shape
        return hash_to_bits(self.panel, rows - 1, cols - 1)

    def shown(self, refreshes: int) -> tuple[PanelSequence, PanelSequence, PanelSequence]:
        """The three photos: white, black, dots; `refreshes` each. The other panel lets all light
        pass."""
        return (
            make_sole_sequence(f"white-{self.panel}", refreshes, self.panel, self.white()),
            make_sole_sequence(f"black-{self.panel}", refreshes, self.panel, BLACK),
            make_sole_sequence(f"dots-{self.panel}", refreshes, self.panel, self.dots()),
        )

    def _discs(self, present: Bits, shift: float) -> Bits:
        """Discs at some places of the lattice, which is shifted by `shift` pitches."""
        picture = np.zeros(self.size_px[::-1], dtype=np.bool_)
        reach = int(np.ceil(self.radius_px)) + 1
        row, col = np.nonzero(present)
        centres = self.centres(np.stack([col, row], axis=-1)) + shift * self.pitch_px
        for x, y in centres.tolist():
            left, top = int(x) - reach, int(y) - reach
            across = np.arange(left, left + 2 * reach + 1) + 0.5 - x
            down = np.arange(top, top + 2 * reach + 1) + 0.5 - y
            disc = across**2 + down[:, None] ** 2 <= self.radius_px**2
            picture[top : top + disc.shape[0], left : left + disc.shape[1]] |= disc
        return picture
