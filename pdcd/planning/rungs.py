"""Which numbers of codes are tried for a wanted error or time, and of which family."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

from pdcd.codes.hadamard import hadamard_fits
from pdcd.codes.singer import line_count
from pdcd.protocol.request import CaptureRequest
from pdcd.words import FamilyName

LADDER = tuple(sorted(k * 2**n for k in (8, 12) for n in range(10)))
"""Numbers of codes that are tried, each a Hadamard order: 8, 12, 16, 24 ... 6144."""

MOST_REPEATS = 64
"""Exposures of one photo beyond which RAW files pile up for little."""

MOST_PARTS = 1000
"""Largest denominator of a share p of lit cells that balanced codes are fitted to."""


def family_of(request: CaptureRequest) -> tuple[FamilyName, int]:
    """The code family, and what its number of codes must be a multiple of."""
    p = request.p
    family: FamilyName = "hadamard" if p is None or p == 0.5 else "balanced"
    family = request.family or family
    if family == "singer" and p is not None:
        return family, line_count(p)
    share = Fraction(0.5 if p is None else p).limit_denominator(MOST_PARTS)
    return family, share.denominator if family == "balanced" else 1


def parts_of(request: CaptureRequest) -> int:
    """In how many parts a request wants its codes."""
    return request.parts if isinstance(request.parts, int) else 1


def most_repeats(request: CaptureRequest) -> int:
    """How often a photo may be taken: one in parts only once (`pdcd.planning.make`)."""
    return MOST_REPEATS if parts_of(request) == 1 else 1


def counts_of(request: CaptureRequest) -> Iterator[int]:
    """Numbers of codes that the family can have, each once, few first: those of the ladder, or the
    next multiples of what it needs; as many in each part where the request names parts."""
    family, step = family_of(request)
    parts = parts_of(request)
    for count in dict.fromkeys(-(-rung // step) * step for rung in LADDER):
        if family != "hadamard" or hadamard_fits(count, request.p or 0.5):
            yield parts * count
