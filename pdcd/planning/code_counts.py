"""How many codes a photo has: the numbers that are tried for a wanted error or time, with their
family; and the number that keeps photos of any p equally bright, K in proportion to 1 / p (Fig. 8).
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

from pdcd.codes.hadamard import can_make_hadamard_codes
from pdcd.codes.singer import count_plane_lines
from pdcd.errors import RequestError
from pdcd.protocol.request import CaptureRequest
from pdcd.words import FamilyName

LADDER = tuple(sorted(k * 2**n for k in (8, 12) for n in range(10)))
"""Numbers of codes that are tried, each a Hadamard order: 8, 12, 16, 24 ... 6144."""

MOST_REPEATS = 64
"""Most exposures of one photo: more RAW files gain little."""

_MOST_PARTS = 1000
"""Largest denominator of a share p of lit cells that balanced codes are fitted to."""


def find_code_family(request: CaptureRequest) -> tuple[FamilyName, int]:
    """The code family, and the number that its number of codes must be a multiple of."""
    p = request.p
    family: FamilyName = "hadamard" if p is None or p == 0.5 else "balanced"
    family = request.family or family
    if family == "singer" and p is not None:
        return family, count_plane_lines(p)
    share = Fraction(0.5 if p is None else p).limit_denominator(_MOST_PARTS)
    return family, share.denominator if family == "balanced" else 1


def count_parts(request: CaptureRequest) -> int:
    """The number of parts that a request asks for."""
    return request.parts if isinstance(request.parts, int) else 1


def list_code_counts(request: CaptureRequest) -> Iterator[int]:
    """Numbers of codes of one exposure that the family can have, each once, ascending: those of the
    ladder, rounded up to multiples of what the family needs."""
    family, step = find_code_family(request)
    for count in dict.fromkeys(-(-rung // step) * step for rung in LADDER):
        if family != "hadamard" or can_make_hadamard_codes(count, request.p or 0.5):
            yield count


_NEAR = 0.25
"""How far from the number by the rule others are tried, over that number."""


def scale_code_count(codes: int, request: CaptureRequest) -> int:
    """Codes in which matched cells are lit as often as in `codes` at p = 1/2: ``codes / (2 p)``.

    The nearest number is taken for which cells can be lit in exactly a share p of the codes, if
    there is one near. Raises RequestError for goals in which p does not scale other light.
    """
    if request.p is None or request.goal not in ("fraction", "off-diagonal"):
        raise RequestError(
            "equal brightness is for photos that keep a share p of other light",
            hint="take the goal fraction, or off-diagonal, with p",
        )
    rule = 0.5 * codes / request.p
    nearest = max(1, round(rule))
    for away in range(int(_NEAR * rule) + 1):
        for count in (nearest - away, nearest + away):
            lit = request.p * count
            if round(lit) >= 1 and abs(lit - round(lit)) <= 1e-9 * count:
                return count
    return nearest
