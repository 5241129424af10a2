"""As many codes as keep photos of any p equally bright: K in proportion to 1 / p (Fig. 8)."""

from __future__ import annotations

from pdcd.errors import RequestError
from pdcd.protocol.request import CaptureRequest

NEAR = 0.25
"""How far from the number that the rule gives another one is looked for, over that number."""


def as_bright(codes: int, request: CaptureRequest) -> int:
    """Codes in which matched cells are lit as often as in `codes` at p = 1/2: ``codes / (2 p)``.

    The nearest number is taken for which cells can be lit in exactly a share p of the codes, if
    there is one near. Raises RequestError for a goal in which p does not keep matched light.
    """
    if request.p is None or request.goal not in ("fraction", "off-diagonal"):
        raise RequestError(
            "equal brightness is for photos that keep a share p of other light",
            hint="take the goal fraction, or off-diagonal, with p",
        )
    rule = 0.5 * codes / request.p
    nearest = max(1, round(rule))
    for away in range(int(NEAR * rule) + 1):
        for count in (nearest - away, nearest + away):
            lit = request.p * count
            if round(lit) >= 1 and abs(lit - round(lit)) <= 1e-9 * count:
                return count
    return nearest
