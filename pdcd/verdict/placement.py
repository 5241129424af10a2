"""Whether the panels show the codes where they are believed to, from the photos themselves.

There are two tests, both of means over cells, and neither needs a further photo:

- *Direct light.* Photos that keep another share of direct than of other light measure how much of
  it there is. Where mask and projector show different places, no cell is lit through its own
  window, and the scene seems to have no direct light; where one of them is inverted, less than
  none.
- *Fingerprints.* If a panel were mirrored or turned, direct light would come by the code of the
  mirrored cell. The realised probing matrix predicts how much that would be, cell by cell; this is
  looked for in the fine detail of the photo. It needs no white photo, and names the fault.

The codes of neighbours are kept apart, evenly. So a shift by a few cells leaves no fingerprint,
only the loss of direct light.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pdcd.arrays import Bools, Floats, Indices
from pdcd.probing.realised import Factors

_LIT = 0.1
"""Share of the bright cells' light below which a cell is not used."""
_APART = 0.2
"""Least difference of two photos in the share of direct light that they keep, over that share."""
PRODUCTS = 2**18
"""Most products of factors for one fingerprint; where there are more, central cells are used."""
_SIDE = 3
"""Side, in cells, of the square whose mean is subtracted, so that fine detail remains."""
_WIDE = 5
"""Side, in cells, of the square over which chance is averaged."""
_FLAT = 0.01
"""Spread of a fingerprint over its mean below which it looks like the light itself."""
_FEWEST = 64
"""Least number of cells for a finding: in a few, chance looks like a pattern."""


@dataclass(frozen=True)
class LightSample:
    """Light of an exposure, or of several that were added, and what the panels did to it.

    light : (N,) grey, mean over each cell; NaN where no pixel sees the cell.
    reference : (N,) the same of a photo with all light, in any unit; None where there is none.
    """

    light: Floats
    realised: Factors
    reference: Floats | None = None


@dataclass(frozen=True)
class PlacementFit:
    """How well photos fit a panel that lies in another way: the share of light that follows its
    codes (1: all; -1: all, by the inverse codes), and that over what chance gives."""

    name: str
    share: float
    over_chance: float


def list_panel_symmetries(grid: tuple[int, int]) -> dict[str, Indices]:
    """The ways in which a panel may lie wrongly and still cover the field: the cell that is shown
    in the place of each, (N,). Quarter turns only where the grid is square."""
    cells = np.arange(grid[0] * grid[1]).reshape(grid)
    ways = {
        "mirrored left to right": cells[:, ::-1],
        "mirrored top to bottom": cells[::-1],
        "turned by 180 degrees": cells[::-1, ::-1],
    }
    if grid[0] == grid[1]:
        ways |= {
            "turned by 90 degrees": np.rot90(cells),
            "turned by 270 degrees": np.rot90(cells, 3),
            "mirrored about a diagonal": cells.T,
            "mirrored about the other diagonal": np.rot90(cells, 2).T,
        }
    return {name: np.ascontiguousarray(way.ravel()) for name, way in ways.items()}


def map_direct_shares(samples: Sequence[LightSample], grid: tuple[int, int]) -> Floats:
    """Share of direct light in all light around every cell, (N,); NaN where it is not lit, and
    everywhere if the photos cannot measure it. For the verdict.

    The light of a cell in each photo is ``d D + o I``: d from `coaxial`, o the mean weight of all
    other cells. D and I follow by least squares. Only for photos that want all other cells alike.
    """
    shares = np.full(grid[0] * grid[1], np.nan)
    if len(samples) < 2:
        return shares
    light = np.stack([s.light for s in samples])
    direct = np.stack([s.realised.coaxial for s in samples])
    other = np.stack([_other(s.realised) for s in samples])
    dd, oo = np.sum(direct**2, axis=0), np.sum(other**2, axis=0)
    do = np.sum(direct * other, axis=0)
    apart = dd * oo - do**2
    known = (apart > _APART**2 * dd * oo) & np.isfinite(light).all(axis=0)
    if known.sum() < _FEWEST:
        return shares
    safe = np.where(known, apart, 1.0)
    light = np.where(known, light, 0.0)
    dl, ol = np.sum(direct * light, axis=0), np.sum(other * light, axis=0)
    own, rest = (oo * dl - do * ol) / safe, (dd * ol - do * dl) / safe
    # The codes' errors change from cell to cell: around a cell they cancel.
    around = [_low(np.where(known, part, 0.0).reshape(grid), _WIDE) for part in (own, own + rest)]
    total = around[1].ravel()
    lit = known & (total > _LIT * np.percentile(total[known], 90.0)) & (total > 0.0)
    if lit.sum() >= _FEWEST:
        shares[lit] = around[0].ravel()[lit] / total[lit]
    return shares


def fit_fingerprints(sample: LightSample, grid: tuple[int, int]) -> Iterator[PlacementFit]:
    """How the fine detail of one photo fits panels that are mirrored or turned; (N,) cells on
    `grid`. Yields nothing where codes or light have too little detail."""
    block = _block(grid, len(sample.realised.left))
    cells = np.arange(grid[0] * grid[1]).reshape(grid)[block]
    here = cells.ravel()
    seen = _detail(sample.light, sample.reference, grid)
    if here.size < _FEWEST or seen is None:
        return
    light, lit = seen[0][block], seen[1][block]
    realised, opened = sample.realised, _other(sample.realised)
    level = float(opened[here].mean())
    if lit.sum() < _FEWEST or not level > 0.0:
        return

    def fine(weights: Floats) -> Floats:
        return _high(weights.reshape(cells.shape) / level)

    # Detail that is there also where panels lie as believed: codes open cells unequally, or keep
    # direct light of some.
    base = [fine(realised.coaxial[here]), fine(opened[here])]
    even = _find_evenly_lit(realised, grid)
    for name, way in list_panel_symmetries(grid).items():
        there = way[here]
        # The edge of an illumination is fine detail, too, however a panel lies.
        told = lit & (even[here] & even[there]).reshape(cells.shape)
        if told.sum() < _FEWEST:
            continue
        for mask, projector in ((here, there), (there, here)):
            shown = _products(realised, mask, projector)
            moved = np.stack([part[told] for part in (*base, fine(opened[mask]))], axis=1)
            yield from _fit(name, light[told], fine(shown)[told], moved)


def _find_evenly_lit(realised: Factors, grid: tuple[int, int]) -> Bools:
    """Cells that the projector lights about as long as those around, (N,)."""
    lit_s = realised.right.sum(axis=0).reshape(grid)
    least, most = (
        pick(lit_s, _SIDE, mode="nearest")
        for pick in (scipy.ndimage.minimum_filter, scipy.ndimage.maximum_filter)
    )
    even: Bools = (least > _LIT * most).ravel()
    return even


def fit_stack_fingerprints(
    samples: Sequence[LightSample], grid: tuple[int, int]
) -> Iterator[PlacementFit]:
    """The same for photos of one code each through an open mask: from photo to photo, a cell is
    bright when its own projector cell is. "as believed" comes first."""
    if len(samples) < 2:
        return
    light = np.stack([s.light for s in samples])
    mean = light.mean(axis=0)
    known = np.isfinite(mean)
    if known.sum() < _FEWEST:
        return
    lit = known & (mean > _LIT * np.percentile(mean[known], 90.0)) & (mean > 0.0)
    if lit.sum() < _FEWEST:
        return
    seen = (light[:, lit] / mean[lit] - 1.0).ravel()
    same = np.arange(grid[0] * grid[1])
    base = np.zeros((seen.size, 0))
    for name, way in {"as believed": same, **list_panel_symmetries(grid)}.items():
        codes = np.stack([_products(s.realised, same, way) for s in samples])[:, lit]
        level = codes.mean(axis=0)
        if not level.min() > 0.0:
            continue
        shown = (codes / level - 1.0).ravel()
        yield from _fit(name, seen, shown, base)
        if way is same:
            base = shown[:, None]


def _other(realised: Factors) -> Floats:
    """Mean weight of all other cells' light in each cell, (N,)."""
    rows = realised.right.sum(axis=1) @ realised.left
    mean: Floats = (rows - realised.coaxial) / max(rows.size - 1, 1)
    return mean


def _products(realised: Factors, mask: Indices, projector: Indices) -> Floats:
    """Weight of light of some projector cells through the windows of some mask cells, (n,) each."""
    left, right = realised.left[:, mask], realised.right[:, projector]
    products: Floats = np.einsum("rn,rn->n", left, right)
    return products


def _block(grid: tuple[int, int], rows: int) -> tuple[slice, slice]:
    """Cells around the centre, as many as `PRODUCTS` allows."""
    share = min(1.0, float(np.sqrt(PRODUCTS / max(rows * grid[0] * grid[1], 1))))
    sides = [max(int(share * n), 1) for n in grid]
    down, right = ((n - side) // 2 for n, side in zip(grid, sides, strict=True))
    return slice(down, down + sides[0]), slice(right, right + sides[1])


def _detail(
    light: Floats, reference: Floats | None, grid: tuple[int, int]
) -> tuple[Floats, Bools] | None:
    """Relative change of light from cell to cell, (rows, cols); and the cells where it is known.

    Relative to the reference where there is one, else to the mean of the cells around.
    """
    image = light.reshape(grid)
    lit = np.isfinite(image)
    image = np.where(lit, image, 0.0)
    if reference is None:
        below = _low(np.maximum(image, 0.0), _WIDE)
    else:
        below = reference.reshape(grid)
        lit &= np.isfinite(below)
        below = np.where(lit, below, 0.0)
    if not lit.any():
        return None
    least = _LIT * float(np.percentile(below[lit], 90.0))
    if not least > 0.0:
        return None
    lit &= below > least
    ratio = image / np.maximum(below, least)
    level = float(ratio[lit].mean())
    if not level > 0.0:
        return None
    return np.clip(_high(ratio / level), -1.0, 1.0), lit


def _high(image: Floats) -> Floats:
    return image - _low(image, _SIDE)


def _low(image: Floats, side: int) -> Floats:
    smooth: Floats = scipy.ndimage.uniform_filter(image, side, mode="nearest")
    return smooth


def _fit(name: str, seen: Floats, shown: Floats, base: Floats) -> Iterator[PlacementFit]:
    """Least-squares share of `shown` in `seen`, (M,) each, after fitting `base` (M, B) to both."""
    if base.size:
        both = np.stack([seen, shown], axis=1)
        seen, shown = (both - base @ np.linalg.lstsq(base, both, rcond=None)[0]).T
    power, light = float(shown @ shown), float(seen @ seen)
    if power <= _FLAT**2 * seen.size or not light > 0.0:
        return
    inner = float(seen @ shown)
    chance = np.sqrt(light * power / seen.size)
    yield PlacementFit(name, inner / power, inner / float(chance))
