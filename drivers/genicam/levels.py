"""What sample values mean if the format does not say: black, white, alignment, byte order.

A 12-bit converter behind a 16-bit format may put its bits on the left (16 bits with zeros at the
end), on the right (nothing above 4095), or send its bytes in the wrong order. Each case shows in
the samples; what was found once is kept while the camera is open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .pixels import PixelFormat, Samples

_WORD_BITS = 16
_CONVERTERS = (10, 12, 14)
"""Bits of converters behind a 16-bit format."""
_SWAPPED = 8.0
"""How many times rougher a picture must be in one byte order than in the other for the order to be
known: swapped, steps of one become steps of 256."""
_MANY, _SOME = 64, 20000
"""Number of different values, among this many samples, from which bits that are never set are
significant."""
_LEAST_ROUGHNESS = 0.05
"""Mean step between neighbours, DN, below which the byte order does not show."""


@dataclass
class SampleLevels:
    """Reads samples of one format, and learns from them what their values mean.

    white : DN that the user configured, or that was seen; None without either.
    told : DN in the camera's own node map, until a sample above it proves it wrong; else None.
    swapped : whether bytes come in the wrong order; None until it shows.
    zeros : number of lowest bits that were never set; None until a picture was seen.
    """

    pixel_format: PixelFormat
    white: int | None = None
    told: int | None = None
    swapped: bool | None = None
    zeros: int | None = None
    _seen: int = field(default=0, repr=False)

    def read(self, samples: Samples) -> Samples:
        """The samples with their bytes in the right order; learns from them."""
        if self.pixel_format.layout == "words":
            if self.swapped is None:
                self.swapped = find_byte_order(samples, self.pixel_format.bits)
            if self.swapped:
                samples = samples.byteswap()
            if self.pixel_format.bits == _WORD_BITS:
                self._learn(samples)
        if self.told is not None and int(samples.max()) > self.told:
            self.told = None
        return samples

    def _learn(self, samples: Samples) -> None:
        used = int(np.bitwise_or.reduce(samples, axis=None))
        if used:
            trailing = (used & -used).bit_length() - 1
            self.zeros = trailing if self.zeros is None else min(self.zeros, trailing)
        if self.white is self.told is None and not self.zeros:
            highest = int(samples.max())
            # A converter's highest value, and nothing above it: a frame with saturated samples.
            if highest in (2**bits - 1 for bits in _CONVERTERS) and highest >= self._seen:
                if np.count_nonzero(samples == highest) > 1:
                    self.white = highest
            self._seen = max(self._seen, highest)

    @property
    def white_dn(self) -> int:
        """DN from which a sample is saturated, as far as is known."""
        for known in (self.white, self.told):
            if known is not None:
                return known
        bits = self.pixel_format.bits
        if bits == _WORD_BITS and self.zeros:
            return (1 << _WORD_BITS) - (1 << self.zeros)
        return (1 << bits) - 1

    @property
    def words(self) -> dict[str, str]:
        """What was found, for the record of a photo."""
        found = {}
        if self.swapped:
            found["ByteOrder"] = "swapped"
        if self.zeros:
            found["Alignment"] = f"left, {_WORD_BITS - self.zeros} bits"
        return found


def find_byte_order(samples: Samples, bits: int) -> bool | None:
    """Whether the bytes of samples come in the wrong order; None if it does not show.

    bits : of the format; values beyond them are impossible. In 16 bits, the bits that a smaller
    converter never sets lie at one end, but in the middle if bytes are swapped. Otherwise
    neighbours decide: light and noise vary by a few DN, which swapped become hundreds.
    """
    swapped = samples.byteswap()
    if bits < _WORD_BITS:
        beyond, beyond_swapped = (int(seen.max()) >> bits for seen in (samples, swapped))
        if bool(beyond) is not bool(beyond_swapped):
            return bool(beyond)
    torn, torn_swapped = (_is_torn(seen) for seen in (samples, swapped))
    if torn is not torn_swapped:
        return torn
    native_dn, swapped_dn = _roughness(samples), _roughness(swapped)
    if max(native_dn, swapped_dn) < _LEAST_ROUGHNESS:
        return None
    if swapped_dn * _SWAPPED < native_dn:
        return True
    return False if native_dn * _SWAPPED < swapped_dn else None


def _is_torn(samples: Samples) -> bool:
    """Whether bits next to the border of the two bytes are never set, but bits on both sides
    are."""
    some = samples.ravel()[:: max(1, samples.size // _SOME)]
    if np.unique(some).size < _MANY:
        return False
    used = int(np.bitwise_or.reduce(samples, axis=None))
    for bits in _CONVERTERS:
        unset = (1 << _WORD_BITS - bits) - 1
        for gap in (unset << 8, unset << bits - 8):
            below, above = (gap & -gap) - 1, ~(gap | (gap - 1)) & 0xFFFF
            if not used & gap and used & below and used & above:
                return True
    return False


def _roughness(samples: Samples) -> float:
    """Typical step between neighbours of one colour in a row, two samples apart as in a mosaic: the
    mean of the smaller half of all steps, which excludes edges."""
    signed = samples.astype(np.int32)
    steps = np.abs(signed[:, 2:] - signed[:, :-2]).ravel()
    if not steps.size:
        return 0.0
    half = np.partition(steps, steps.size // 2)[: steps.size // 2 + 1]
    return float(half.mean())


def measure_black(samples: NDArray[np.uint16], cfa: str | None) -> int | Sequence[int]:
    """Level of a dark frame; for a mosaic, of each place of the quad, row by row.

    It is the mean without the darkest and brightest tenth of samples, so hot ones do not count.
    """
    if cfa is None:
        return _middle(samples)
    return [_middle(samples[row::2, column::2]) for row in (0, 1) for column in (0, 1)]


def _middle(samples: NDArray[np.uint16]) -> int:
    low, high = np.quantile(samples, (0.1, 0.9))
    kept = samples[(samples >= low) & (samples <= high)]
    return round(float(kept.mean()))
