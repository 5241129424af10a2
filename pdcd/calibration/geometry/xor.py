"""XOR codes: Gray codes without low frequencies, for scenes with strong light between surfaces.

Gupta, Agrawal, Veeraraghavan, Narasimhan 2011, Structured Light 3D Scanning in the Presence of
Global Illumination: every bit of a Gray code is XORed with the finest stripes (XOR-02, two pixels
wide) or the second finest (XOR-04). All pictures then have half of their pixels lit within any few
pixels, so the global light is the same in all of them. At edges of the base stripes all bits flip
together; a median over 5 x 5 quads takes that out. Each picture is shown with its inverse.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools
from pdcd.calibration.geometry.lit import LIT_SIGMAS
from pdcd.calibration.geometry.phase import AXES, LEAST_VALID, DecodedQuads, make_panel_sequence
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import Bits, PanelName, PanelSequence
from pdcd.errors import CalibrationError

_MEDIAN = 5
"""Quads a side over which the median is taken."""
_LEAST_SURE = 0.5
"""Share of them whose bits are all clear."""


@dataclass(frozen=True)
class XorCode:
    """The patterns of one panel.

    size_px : (width, height). base_px : width of the base stripes: 2 (where a pixel's light is not
        blurred), 4, or a higher power of two for a camera that does not resolve these.
    """

    panel: PanelName
    size_px: tuple[int, int]
    base_px: int = 4

    def bits(self, axis: int) -> int:
        """Bits that number the pixels along an axis."""
        return max(3, (self.size_px[axis] - 1).bit_length())

    @property
    def base_bit(self) -> int:
        """Which bit, counted from the finest one, is the base."""
        return self.base_px.bit_length() - 2

    def lines(self, axis: int) -> Bools:
        """(bits, pixels) bool along an axis, the highest bit first. The base bit itself is not
        XORed."""
        number = np.arange(self.size_px[axis])
        gray = number ^ (number >> 1)
        base = gray >> self.base_bit & 1
        bits = self.bits(axis)
        planes = [
            (gray >> bit & 1) ^ (0 if bit == self.base_bit else base)
            for bit in reversed(range(bits))
        ]
        return np.array(planes, dtype=np.bool_)

    def shown(self, refreshes: int) -> tuple[PanelSequence, ...]:
        """The photos in the order in which they are decoded: each bit and its inverse."""
        index = np.zeros(refreshes, dtype=np.int32)
        found = []
        for axis, name in enumerate(AXES):
            for bit, line in enumerate(self.lines(axis)):
                for inverse in (False, True):
                    title = f"xor-{name}{bit}{'-inverse' if inverse else ''}-{self.panel}"
                    picture = self._drawn(axis, line ^ inverse)
                    found.append(make_panel_sequence(title, self.panel, picture, index))
        return tuple(found)

    def _drawn(self, axis: int, line: Bools) -> Bits:
        lines = line[None, None, :] if axis == 0 else line[None, :, None]
        return np.broadcast_to(lines, (1, self.size_px[1], self.size_px[0]))


class XorPlanes:
    """The photos of one panel as they come, two a bit, in the order of `XorCode.shown`."""

    def __init__(self, code: XorCode) -> None:
        self.code = code
        self._planes: list[Bools] = []
        self._sure: Bools | None = None
        self._lit: QuadPhoto | None = None

    def add(self, photo: QuadPhoto) -> None:
        """The next photo: a bit, or the inverse of the one before."""
        if self._lit is None:
            self._lit = photo
            return
        lit, self._lit = self._lit, None
        difference = lit.main - photo.main
        noise = np.sqrt(lit.main_variance + photo.main_variance)
        clear = np.asarray(np.abs(difference) > LIT_SIGMAS * noise)
        for one in (lit, photo):
            clear &= True if one.saturated is None else ~one.saturated
        self._sure = clear if self._sure is None else self._sure & clear
        self._planes.append(difference > 0.0)

    def decoded(self) -> DecodedQuads:
        """What each quad sees, after the last photo. Raises CalibrationError where hardly any can
        be decoded."""
        code, places, first = self.code, [], 0
        for axis in (0, 1):
            number = _number(self._planes[first : first + code.bits(axis)], code)
            first += code.bits(axis)
            smooth = cv2.medianBlur(number.astype(np.float32), _MEDIAN)
            places.append(smooth.astype(np.float64) + 0.5)
        panel_px = np.stack(places, axis=-1)
        share = cv2.blur(np.asarray(self._sure, dtype=np.float32), (_MEDIAN, _MEDIAN))
        good = (share >= _LEAST_SURE) & (panel_px < code.size_px).all(axis=-1)
        if good.mean() < LEAST_VALID:
            raise CalibrationError(
                f"the code is seen in {good.mean():.1%} of the photo only",
                device=code.panel,
                hint="expose so that white is well lit and not saturated, focus, take off the lens "
                "cap",
            )
        # A whole pixel is uniformly wrong by up to half of one.
        sigma = np.full(panel_px.shape, 1.0 / np.sqrt(12.0))
        return DecodedQuads(panel_px, sigma, np.asarray(good, dtype=np.bool_))


def _number(planes: list[Bools], code: XorCode) -> NDArray[np.int32]:
    """Pixel numbers, (h, w), out of bits, the highest first."""
    last = len(planes) - 1
    base = planes[last - code.base_bit]
    number = np.zeros(base.shape, dtype=np.int32)
    bit = np.zeros(base.shape, dtype=np.bool_)
    for place, plane in enumerate(planes):
        bit = bit ^ (plane if last - place == code.base_bit else plane ^ base)
        number = 2 * number + bit
    return number
