"""Light that a photo was to block and that got through all the same, by the realised matrix."""

from __future__ import annotations

import numpy as np

from pdcd.probing.convolved import SameRow
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import Match, Part, Wanted


def blocked_parts(wanted: Wanted) -> list[Part]:
    """The paths that a photo is to block: of matched cells, or of rows. Direct light of an off-axis
    bench takes one of these, and nobody knows which."""
    return [p for w, p in wanted.parts if w < 0.0 and isinstance(p, Match | SameRow)]


def blocked_weight(realised: Factors, wanted: Wanted, weight_s: float) -> float:
    """Mean weight in a photo of its `blocked_parts`, 0 where it has none.

    weight_s : of a path with a wanted weight of 1, in seconds.
    """
    own = np.arange(wanted.cells)
    got = paths = 0.0
    for part in blocked_parts(wanted):
        diagonal = part.entries(own)
        through = np.einsum("rn,rn->n", realised.left, part.others(realised.right))
        got += float(np.sum(through + diagonal * realised.coaxial))
        paths += float(np.sum(part.others(np.ones((1, wanted.cells))) + diagonal))
    return got / (paths * weight_s) if paths else 0.0
