"""Complement pairs: the same codes twice, before the mask's codes and before their complement.

One exposure gathers ``sum_k (1 - i_k) i_k^T``: indirect light alone. The other, ``sum_k i_k
i_k^T``, has all direct light and the same indirect light again. So their difference is direct
light, and their sum is all light, without any error of the codes where these light every cell
equally often.

A floodlit shot beside them is a check: it must show what the two add up to.
"""

from __future__ import annotations

from dataclasses import replace

from pdcd.errors import RequestError
from pdcd.probing.wanted import Uniform
from pdcd.recipes.maker import Maker, itself
from pdcd.recipes.programs import Coded
from pdcd.recipes.recipe import Photo, Recipe, Rule, Shot

FLOODLIT = "floodlit"
"""The photo and picture of a white shot, beside the white picture of a pair."""
KNOWN = ("indirect", "direct")
"""Goals that a pair of exposures answers."""


def paired(maker: Maker, white: bool, buckets: int = 1) -> Recipe:
    """Two exposures for direct, indirect and all light; and with `white` a floodlit shot to hold
    their sum against.

    A sensor of two buckets takes both at once. Raises RequestError for goals that are more than
    that.
    """
    target = maker.target
    if target.goal.name not in KNOWN or target.light is not None:
        raise RequestError(
            f"method pairs does the goals {' and '.join(KNOWN)}, under full light",
            hint="take the method coded",
        )
    everything, same = Uniform(target.cells), itself(target)
    if white:
        maker.photo(
            FLOODLIT, maker.wanted((1.0, everything)), [(1.0, Shot("white", "", white=True))]
        )
    maker.coded("coded", Coded(None, True), (1.0, everything), (-1.0, same))
    maker.coded("same", Coded(None, False), (0.5, everything), (0.5, same))
    if buckets == 2:
        of = len("same")
        maker.shots = [
            replace(shot, beside=f"coded{shot.name[of:]}") if shot.program == "same" else shot
            for shot in maker.shots
        ]
    apart, together = maker.photos[-2], maker.photos.pop()
    less = tuple((-sign, name) for sign, name in apart.shots)
    maker.photos += [
        Photo("white", maker.wanted((1.0, everything)), (*together.shots, *apart.shots)),
        Photo("direct", maker.wanted((1.0, same)), (*together.shots, *less)),
    ]
    pictures: dict[str, Rule] = {
        "indirect": ((1.0, "coded"),),
        "white": ((1.0, "white"),),
        "direct": ((1.0, "direct"),),
    }
    first = target.goal.name
    pictures = {first: pictures[first], **pictures}
    if white:
        pictures[FLOODLIT] = ((1.0, FLOODLIT),)
    return Recipe(target, maker.programs, tuple(maker.shots), tuple(maker.photos), pictures)
