"""How each goal is photographed by codes: its photos and pictures, one small function a goal."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from pdcd.arrays import Floats
from pdcd.probing.convolved import KernelPart
from pdcd.probing.wanted import MatchPart, OuterPart, UniformPart, WantedMatrix, shift_cells
from pdcd.recipes import off_axis
from pdcd.recipes.maker import RecipeMaker
from pdcd.recipes.partners import Partner, list_partner_cells
from pdcd.recipes.programs import CodedProgram, ConvolvedProgram, SignedProgram
from pdcd.recipes.recipe import Extremes, Rule

_STRIPES = 4
"""Positions of the stripes of the goal "split"."""

MANY_TAPS = 256
"""Number of taps of a kernel from which they are not added up one by one."""


def _all_but_matched(maker: RecipeMaker, name: str = "coded", light: Floats | None = None) -> None:
    """A photo of all light except that from the matched cell; cells without one stay closed."""
    everything, match = _parts(maker)
    program = CodedProgram(maker.target.partner, True)
    striped = light is not None
    maker.coded(name, program, (1.0, everything), (-1.0, match), light=light, by_light=striped)


def _parts(maker: RecipeMaker) -> tuple[OuterPart, MatchPart]:
    """All light at the cells that have a partner, and the light from the partner."""
    target = maker.target
    partner = list_partner_cells(target.partner, target.grid)
    there = partner >= 0
    every = UniformPart(target.cells)
    return every if there.all() else OuterPart(there.astype(float), every.projector), MatchPart(
        partner
    )


def _white(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    maker.white()
    return {"white": ((1.0, "white"),)}


def _all_light(maker: RecipeMaker) -> None:
    """The white photo that goes with indirect light: the same cells are closed in it."""
    everything, _ = _parts(maker)
    if isinstance(everything, UniformPart):
        maker.white()
        return
    light = everything.projector if maker.target.light is None else maker.target.light
    maker.exact("white", maker.wanted((1.0, everything)), [everything.camera], [light])


def _indirect(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    if not white:
        _all_but_matched(maker)
        return {"indirect": ((1.0, "coded"),)}
    _all_light(maker)
    _all_but_matched(maker)
    direct = ((1.0, "white"), (-1.0, "coded"))
    return {"indirect": ((1.0, "coded"),), "white": ((1.0, "white"),), "direct": direct}


def _direct(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    pictures = _indirect(maker, True, codes)
    return {name: pictures[name] for name in ("direct", "white", "indirect")}


def _fraction(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    p = maker.target.goal.p or 0.0
    everything, match = _parts(maker)
    program = CodedProgram(maker.target.partner, False, p)
    maker.coded(
        "coded", program, (p, everything), (1.0 - p, match),
        by_direct=True, by_light=maker.target.partner is not None,
    )  # fmt: skip
    return {"fraction": ((1.0, "coded"),)}


def _matched(maker: RecipeMaker, name: str, partner: Partner) -> None:
    """A photo of one chosen projector cell for each camera cell, by signed codes."""
    part = MatchPart(list_partner_cells(partner, maker.target.grid))
    maker.signed(name, lambda positive: SignedProgram(((1.0, partner),), positive), (1.0, part))


def _diagonal(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    _matched(maker, "matched", None)
    return {"diagonal": ((1.0, "matched"),)}


def _off_diagonal(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    if maker.target.goal.p is not None:
        return {"off-diagonal": _fraction(maker, white, codes)["fraction"]}
    _matched(maker, "matched", maker.target.goal.shift)
    return {"off-diagonal": ((1.0, "matched"),)}


def _warped(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    _matched(maker, "matched", maker.target.planes["warp"].astype(np.int64))
    return {"warped": ((1.0, "matched"),)}


def _two_samples(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    a, b = maker.target.goal.mix or (0.0, 0.0)
    _matched(maker, "first", maker.target.planes["warp"].astype(np.int64))
    _matched(maker, "second", maker.target.planes["warp_b"].astype(np.int64))
    return {"two-samples": ((a, "first"), (b, "second"))}


def _illuminated(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    maker.white()
    return {"illuminated": ((1.0, "white"),)}


def _far(maker: RecipeMaker) -> None:
    maker.far("far", maker.target.goal.radius or 0)


def _long_range(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    _far(maker)
    return {"long-range": ((1.0, "far"),)}


def _short_range(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    _all_but_matched(maker)
    _far(maker)
    pictures: dict[str, Rule] = {"short-range": ((1.0, "coded"), (-1.0, "far"))}
    return {**pictures, "indirect": ((1.0, "coded"),), "long-range": ((1.0, "far"),)}


def _blocked(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    """Two exact pairs: all light seen outside A, and all light except B's seen inside A."""
    planes = maker.target.planes
    a, b = planes["region_a"], planes["region_b"]
    light = np.ones(maker.target.cells) if maker.target.light is None else maker.target.light
    parts = ((1.0, UniformPart(maker.target.cells)), (-1.0, OuterPart(a, b)))
    wanted = WantedMatrix(maker.target.grid, parts, maker.target.light)
    maker.exact("blocked", wanted, [1.0 - a, a], [light, light * (1.0 - b)])
    return {"blocked": ((1.0, "blocked"),)}


def _descattered(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    target = maker.target
    there = shift_cells(target.grid, target.goal.shift or (0, 0))
    # Cells without a neighbour there stay closed, so that both samples cover the same cells.
    here = np.where(there >= 0, np.arange(target.cells), -1)
    parts = ((1.0, MatchPart(here)), (-1.0, MatchPart(there)))
    taps = ((1.0, here), (-1.0, target.goal.shift))
    maker.signed(
        "difference", lambda positive: SignedProgram(taps, positive), *parts, by_direct=True
    )
    return {"descattered": ((1.0, "difference"),)}


def _filtered(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    """``sum_w f_w T_{n, n-w}``: tap w of the kernel pairs n with n - w (Table 2, row 7; X11)."""
    target = maker.target
    kernel = target.matrices["kernel"]
    centre = (kernel.shape[0] // 2, kernel.shape[1] // 2)
    direct = bool(kernel[centre] != 0.0)
    if np.count_nonzero(kernel) >= MANY_TAPS:
        convolved = partial(ConvolvedProgram, kernel)
        part = (1.0, KernelPart(target.grid, kernel))
        maker.signed("filtered", convolved, part, by_direct=direct)
        return {"filtered": ((1.0, "filtered"),)}
    taps = []
    for down, right in zip(*np.nonzero(kernel), strict=True):
        shift = (centre[0] - int(down), centre[1] - int(right))
        taps.append((float(kernel[down, right]), shift))
    parts = [(weight, MatchPart(shift_cells(target.grid, shift))) for weight, shift in taps]
    signed = partial(SignedProgram, tuple(taps))
    maker.signed("filtered", signed, *parts, by_direct=direct)
    return {"filtered": ((1.0, "filtered"),)}


def _split(maker: RecipeMaker, white: bool, codes: int) -> dict[str, Rule]:
    """Indirect photos under stripes that light half of all cells, moved by a quarter period.

    Light of one sharp path is there under some stripes and not under others; half of smooth light
    is there under all. The mean of all four times 2 has every path, once.
    """
    target = maker.target
    period = target.goal.period or 4
    names = tuple(f"stripes-{step}" for step in range(_STRIPES))
    column = np.arange(target.cells) % target.grid[1]
    for step, name in enumerate(names):
        lit = (column + step * period // _STRIPES) % period < period // 2
        _all_but_matched(maker, name, lit.astype(np.float64))
    return {
        "high": Extremes(1.0, -1.0, names),
        "low": Extremes(0.0, 2.0, names),
        "indirect": tuple((2.0 / _STRIPES, name) for name in names),
    }


RECIPES: dict[str, Callable[[RecipeMaker, bool, int], dict[str, Rule]]] = {
    "white": _white,
    "indirect": _indirect,
    "direct": _direct,
    "fraction": _fraction,
    "illuminated": _illuminated,
    "diagonal": _diagonal,
    "off-diagonal": _off_diagonal,
    "warped": _warped,
    "two-samples": _two_samples,
    "long-range": _long_range,
    "short-range": _short_range,
    "blocked": _blocked,
    "descattered": _descattered,
    "filtered": _filtered,
    "split": _split,
    "keyed": off_axis.add_keyed,
    "epipolar": off_axis.add_epipolar,
    "stereo": off_axis.add_stereo,
}
