"""A slice of T out of the photos of its patterns, with the standard deviation of every entry.

Photo k shows at camera cell n, by its realised probing matrix P_k,

    y_kn = sum over j of (P_k)_nj T_nj + o_k c_n

with j the projector cells of the slice, o_k the time for which the mask was open, and c_n all that
comes meanwhile whatever is shown: ambient light, light of black pixels. The mask does the same in
every photo, so P_k is what the cell gathers, u_kn, times what the projector showed, v_kj. Then
``y / u = [v, o] (T, c)``, one system of equations for all cells.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import DecodeError
from pdcd.pictures.captions import strip
from pdcd.pictures.exposed import Exposed
from pdcd.recipes.recipe import Recipe
from pdcd.recipes.transport import Slice, s_matrix
from pdcd.sensor.cells import CellMap

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

LEAST_PURE = 0.2
"""Share of a cell's area that quads must see which see nothing else."""
STEPS = 12
"""After so many, a mixture of half a cell with its neighbours is parted to a thousandth."""
LEAST_PX = 640
"""Width of the picture of a slice, at least."""
BRIGHT_PERCENT = 99.8
LEAST_GREY = 1e-4
"""Of the brightest entries: what the picture of a slice shows at most."""
GREYS = (0.0001, 0.001, 0.01, 0.1, 1.0)


@dataclass(frozen=True, eq=False)
class Sliced:
    """Entries of T.

    entries, sigma : (C, J, 3), light that camera cell n receives of projector cell j at full light,
        scene units, and its standard deviation by the sensor; infinite where a cell is not known.
    seen, lit : (C,) and (J,), numbers of the camera and projector cells.
    photos : of how many.
    uneven : largest difference of P_k from a product of both sides, over its largest entry.
    """

    entries: Floats
    sigma: Floats
    seen: NDArray[np.int64]
    lit: NDArray[np.int64]
    photos: int
    uneven: float

    @property
    def rms_sigma(self) -> float:
        """RMS sigma over the RMS of the entries, where they are known."""
        known = np.isfinite(self.sigma)
        total = float(np.sum(self.entries**2, where=known))
        return float(np.sqrt(np.sum(self.sigma**2, where=known) / total)) if total else np.inf

    def rms_error(self, truth: Floats) -> float:
        """RMS error over the RMS of the true entries (C, J, 3), where they are known."""
        known = np.isfinite(self.sigma)
        total = float(np.sum(truth**2, where=known))
        off = float(np.sum((self.entries - truth) ** 2, where=known))
        return float(np.sqrt(off / total)) if total else np.inf


def sliced(recipe: Recipe, shots: Mapping[str, Exposed], cells: CellMap) -> Sliced:
    """The slice of a recipe of `pdcd.recipes.transport`, whose shots are all there.

    Raises DecodeError where the projector gave a cell no light of its own.
    """
    part = Slice.of(recipe.target.goal, recipe.target.grid)
    taken = [shots[shot.name] for shot in recipe.shots]
    lights = s_matrix(part.lit.size)
    dark = [not lights[shot.only or 0].any() for shot in recipe.shots]
    gathered, shown, opened, uneven = _sides(taken, dark, part)
    known = ~np.logical_or.reduce([shot.saturated for shot in taken])
    sure = cells.seen(known)[part.seen] & (gathered > 0.0).all(axis=0)
    scale = np.divide(1.0, gathered, out=np.zeros_like(gathered), where=gathered > 0.0)
    light, error = _of_cells(taken, known, cells, part)
    light *= scale[..., None]
    error *= scale[..., None]
    system = np.concatenate([shown, opened[:, None]], axis=1)
    if np.linalg.matrix_rank(system) < system.shape[1]:
        raise DecodeError(
            "the photos do not tell the cells of the slice apart",
            hint="look at frames.csv: did the projector show every pattern",
        )
    solved = np.linalg.pinv(system)[:-1]
    entries = np.einsum("jk,kcx->cjx", solved, light)
    sigma = np.sqrt(np.einsum("jk,kcx->cjx", solved**2, error**2))
    sigma[~sure] = np.inf
    return Sliced(entries, sigma, part.seen, part.lit, len(taken), uneven)


def _of_cells(
    taken: list[Exposed], known: Bools, cells: CellMap, part: Slice
) -> tuple[Floats, Floats]:
    """Light of the camera cells of a slice and its standard deviation, (K, C, 3) each.

    Of quads that see one cell alone, where each cell has enough of them. Else all quads count, and
    what they mix is parted again, as if cells were of one value each.
    """
    alone = known & cells.single
    share = cells.mean(alone[..., None].astype(np.float64))[part.seen]
    pure = bool(share.min() >= LEAST_PURE)
    used = alone if pure else known
    light = [cells.mean(shot.light, used) for shot in taken]
    error = [cells.error_of_mean(shot.variance, used)[part.seen] for shot in taken]
    if not pure:
        light = [_parted(mean, cells, known) for mean in light]
        one = np.zeros((cells.grid[0] * cells.grid[1], 1))
        one[part.seen[part.seen.size // 2]] = 1.0
        more = float(np.sqrt(np.sum(_parted(one, cells, known) ** 2)))
        error = [more * sigma for sigma in error]
    return np.stack([mean[part.seen] for mean in light]), np.stack(error)


def _parted(means: Floats, cells: CellMap, known: Bools) -> Floats:
    """Means over cells (N, C) of quads that mix cells -> values of cells, by Van Cittert's steps:
    what cells of these values would look like is subtracted from what was seen."""
    values = means.copy()
    for _ in range(STEPS):
        values += means - cells.mean(cells.spread(values), known)
    return values


def _sides(
    taken: list[Exposed], dark: list[bool], part: Slice
) -> tuple[Floats, Floats, Floats, float]:
    """Both sides of the realised matrices: what cells gather (K, C), of mean 1 in each photo, what
    the projector showed (K, J) and for how long the mask was open (K,), both in seconds, and how
    far the matrices are from products.

    dark : of each photo whether no cell of the slice was to be lit, as in one of a few.
    """
    gathered, shown, opened = [], [], []
    off = most = 0.0
    for shot, black in zip(taken, dark, strict=True):
        whole = shot.realised.left[:, part.seen].T @ shot.realised.right[:, part.lit]
        total = float(whole.sum())
        opened.append(float(shot.realised.open_s[part.seen].mean()))
        if black and not total > 0.0:
            gathered.append(np.ones(len(whole)))
            shown.append(np.zeros(part.lit.size))
            continue
        if not total > 0.0:
            raise DecodeError(
                "a photo of the slice has no light",
                hint="look at frames.csv: did the panels show it while the shutter was open",
            )
        gathered.append(whole.sum(axis=1) * (whole.shape[0] / total))
        shown.append(whole.sum(axis=0) / whole.shape[0])
        off = max(off, float(np.abs(whole - np.outer(gathered[-1], shown[-1])).max()))
        most = max(most, float(whole.max()))
    return np.array(gathered), np.array(shown), np.array(opened), off / most


def picture_of(found: Sliced, title: str) -> NDArray[np.uint8]:
    """A slice to look at, (H, W, 3) uint8: camera cells down, projector cells to the right.

    Brightness goes by the logarithm, from the noise or `LEAST_GREY` of the brightest entries on, so
    that direct light, bands and single paths are all to be seen. What is not known is black.
    """
    known = np.isfinite(found.sigma)
    grey = found.entries[known.all(axis=2)]
    top = float(np.percentile(grey, BRIGHT_PERCENT)) if grey.size else 1.0
    top = max(top, np.finfo(np.float64).tiny)
    noise = float(np.median(found.sigma[known])) if grey.size else 0.0
    low = min(max(noise / top, LEAST_GREY), 0.1)

    def coded(share: Floats | float) -> NDArray[np.uint8]:
        """Share of the brightest entries -> pixel."""
        shade = 1.0 - np.log10(np.maximum(share, low)) / np.log10(low)
        return np.asarray(np.rint(255.0 * np.minimum(shade, 1.0)), np.uint8)

    drawn = np.where(known, coded(found.entries / top), np.uint8(0))
    factor = max(-(-LEAST_PX // drawn.shape[1]), 1)
    drawn = drawn.repeat(factor, axis=0).repeat(factor, axis=1)
    marks = [(int(coded(g)), f"{g * top:.2g}") for g in GREYS if g >= low]
    notes = ["down: camera cells", "right: projector cells", f"{found.photos} photos"]
    return np.concatenate([drawn, strip(drawn.shape[1], title, notes, marks)])
