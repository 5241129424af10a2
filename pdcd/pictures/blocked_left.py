"""Light that a photo was to block and that got through all the same, by the realised matrix."""

from __future__ import annotations

import numpy as np

from pdcd.probing.lines import SameRow
from pdcd.probing.realised import Factors
from pdcd.probing.wanted import Match, Wanted


def blocked_weight(realised: Factors, wanted: Wanted, weight_s: float) -> float:
    """Mean weight in a photo of the paths that it was to block: of matched cells, or of rows.

    weight_s : of a path with a wanted weight of 1, in seconds. 0 for a photo that blocks neither.
    Direct light of an off-axis bench takes one of these paths, and nobody knows which.
    """
    blocked = [p for w, p in wanted.parts if w < 0.0 and isinstance(p, Match | SameRow)]
    own = np.arange(wanted.cells)
    got = paths = 0.0
    for part in blocked:
        diagonal = part.entries(own)
        through = np.einsum("rn,rn->n", realised.left, part.others(realised.right))
        got += float(np.sum(through + diagonal * realised.coaxial))
        paths += float(np.sum(part.others(np.ones((1, wanted.cells))) + diagonal))
    return got / (paths * weight_s) if paths else 0.0
