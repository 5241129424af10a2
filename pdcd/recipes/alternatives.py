"""What a laboratory without a mask would do instead, to compare with on the same rig and scene.

Both need many photos through an open mask, one RAW file each.

*Multi-image*: photo k is ``T i_k`` for code k, and is masked in software. The paper's appendix adds
up ``(1 - i_k) * T i_k``, which uses a pixel only while its own cell is dark, in half of the photos.
Here a line is fitted to each pixel's photos over its own code instead, which uses all of them: its
slope is the direct light, by signed weights, and twice its value at 0 is the indirect. With codes
that light all cells equally often the latter is the paper's sum again; with random ones the paper's
sum has a further error, as its cells are dark unequally often.

*Checkers* (Nayar, Krishnan, Grossberg and Raskar 2006): half of the cells are lit, in a checker
that moves. Where a cell is lit, a photo holds its direct light and half of the indirect; where it
is dark, half of the indirect. So ``direct = max - min`` and ``indirect = 2 min`` over the photos.
This assumes that indirect light is smooth: that it comes from so many cells that half of them are
lit under every checker. A mirror that lights a cell from one other cell breaks this assumption, and
then the answer may be wrong by all of that light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.errors import RequestError
from pdcd.recipes.goals import Target

ALL_DARK = 1e-3
"""Lit share of what a quad sees below which it counts as dark."""
_BLOCK_CELLS = 2
"""Side of a checker's blocks. Smaller ones assume less of the indirect light, but every cell then
lies at the edge of its block, where real projectors are not sharp."""


@dataclass(frozen=True, eq=False)
class CodeMixture:
    """Codes as seen by quads that see several cells, summed over the K photos: (h, w) each.

    codes, squares : sums of the lit share of what a quad sees, and of its square. dark : number of
    photos in which all of it was dark.
    """

    count: int
    codes: Floats
    squares: Floats
    dark: Floats


class MaskedWeights:
    """Weights of the paper's masked sum, ``1 - i_k`` (appendix): indirect light."""

    def __call__(self, bits: Bools) -> Floats:
        """Weights of cells, (K, N), from the lit cells (K, N) of each photo: what to multiply each
        cell of each photo by before they are added up."""
        return np.where(bits, 0.0, 1.0)

    def mixed(self, lit: Floats, all_photos: CodeMixture) -> Floats:
        """Weights in one photo of quads of which the share `lit` was lit. Only photos in which all
        was dark count, scaled as if they were half of the photos."""
        half = 0.5 * all_photos.count
        whole = np.divide(half, all_photos.dark, out=np.zeros_like(lit), where=all_photos.dark > 0)
        return np.where(lit < ALL_DARK, whole, 0.0)


@dataclass(frozen=True)
class FittedWeights:
    """Weights that find given shares of direct and indirect light, by a line through the photos.

    For each cell, over its own code i_k: photo = indirect / 2 + direct * i_k, all other cells being
    lit half of the time. The direct weights are signed and add up to 0, so ambient light and all
    that the photos have in common drop out. For random codes, what is left of other cells has the
    variance ``Q_n / (K - 1)`` in direct light and ``2 Q_n / (K - 1)`` in indirect light, where Q_n
    is the sum of their squared transport (eq. 7 of the paper has Q_n / K). It has none of the term
    ``S_n^2 / K`` of the masked sum, S_n being their sum. It is 0 for Hadamard codes with more codes
    than cells. Cells that are lit never or always cannot be separated from the others; their
    weights are 0.

    Indirect light as an ordinary photo less the direct light would have half of that variance for
    random codes, but the noise of all light: far more where direct light is the stronger.

    direct, indirect : shares to keep.
    """

    direct: float
    indirect: float

    def __call__(self, bits: Bools) -> Floats:
        """Weights of cells, (K, N), as of `MaskedWeights`."""
        lit = bits.sum(axis=0)
        dark = len(bits) - lit
        known = (lit > 0) & (dark > 0)
        of_lit = np.where(known, bits / np.maximum(lit, 1), 0.0)
        of_dark = np.where(known, ~bits / np.maximum(dark, 1), 0.0)
        return np.asarray(self.direct * (of_lit - of_dark) + self.indirect * 2.0 * of_dark)

    def mixed(self, lit: Floats, all_photos: CodeMixture) -> Floats:
        """Weights in one photo of quads of which the share `lit` was lit: by a line through the
        photos over that share."""
        count = all_photos.count
        mean = all_photos.codes / count
        spread = all_photos.squares - count * mean**2
        known = spread > ALL_DARK
        slope = np.divide(lit - mean, spread, out=np.zeros_like(lit), where=known)
        at_dark = np.where(known, 1.0 / count - mean * slope, 0.0)
        return np.asarray(self.direct * slope + 2.0 * self.indirect * at_dark)


def make_checkers(grid: tuple[int, int], block: int = _BLOCK_CELLS) -> Floats:
    """All different positions of a checker with blocks of `block` x `block` cells.

    Every cell is lit in half of the photos, and has every place within a block in some photo, lit
    and dark.

    Returns
    -------
    (2 block^2, N) float64, 0 or 1.
    """
    rows, cols = np.divmod(np.arange(grid[0] * grid[1]), grid[1])
    return np.array(
        [
            ((rows + down) // block + (cols + right) // block) % 2
            for down in range(block)
            for right in range(2 * block)
        ],
        dtype=np.float64,
    )


def find_light_shares(target: Target, method: str) -> tuple[float, float]:
    """How much of direct and of indirect light a goal asks for.

    Raises RequestError for goals that are more than that.
    """
    known = {"direct": (1.0, 0.0), "indirect": (0.0, 1.0), "fraction": (1.0, target.goal.p or 0.0)}
    if target.goal.name not in known:
        raise RequestError(
            f"method {method} cannot do the goal {target.goal.name}",
            hint=f"it does {', '.join(known)}; take the method coded",
        )
    if target.light is not None or target.partner is not None:
        what = "illumination" if target.light is not None else "shift or warp"
        raise RequestError(
            f"method {method} takes no {what}", hint="leave it out, or take the method coded"
        )
    return known[target.goal.name]
