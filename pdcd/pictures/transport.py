"""A slice of T from the photos of its patterns, with the standard deviation of every entry.

Photo k shows at camera cell n, by its realised probing matrix P_k,
    y_kn = sum over j of (P_k)_nj T_nj + o_k c_n
with j the projector cells of the slice, o_k the time for which the mask was open, and c_n the light
that comes meanwhile whatever is shown: ambient light, light of black pixels. The mask does the same
in every photo, so P_k is what the cell gathers, u_kn, times what the projector showed, v_kj. Then
``y / u = [v, o] (T, c)``, one system of equations for all cells.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Bools, Floats
from pdcd.errors import DecodeError
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.to_cells import unmix_some_cells
from pdcd.pictures.written.picture_files import draw_caption
from pdcd.recipes.recipe import Recipe
from pdcd.recipes.transport import Slice, make_s_matrix
from pdcd.sensor.cells import CellMap

_LEAST_PX = 640
"""Width of the picture of a slice, at least."""
_BRIGHT_PERCENT = 99.8
_LEAST_GREY = 1e-4
"""Least grey, as a share of the brightest entries, that the picture of a slice can show."""
_GREYS = (0.0001, 0.001, 0.01, 0.1, 1.0)


@dataclass(frozen=True, eq=False)
class TransportSlice:
    """Entries of T.

    entries, sigma : (M, J, C), light that camera cell n receives from projector cell j at full
        light, scene units, and its standard deviation by the sensor; infinite where a cell is not
        known.
    seen, lit : (M,) and (J,), numbers of the camera and projector cells.
    photos : number of photos used.
    uneven : largest difference of P_k from a product of both sides, over its largest entry.
    common : share of the light of all photos that comes whatever is shown. The entries are without
        it; the picture of the scene under all patterns is not.
    """

    entries: Floats
    sigma: Floats
    seen: NDArray[np.int64]
    lit: NDArray[np.int64]
    photos: int
    uneven: float
    common: float

    @property
    def rms_sigma(self) -> float:
        """RMS sigma over the RMS of the entries, where they are known."""
        known = np.isfinite(self.sigma)
        total = float(np.sum(self.entries**2, where=known))
        return float(np.sqrt(np.sum(self.sigma**2, where=known) / total)) if total else np.inf

    def rms_error(self, truth: Floats) -> float:
        """RMS error over the RMS of the true entries (M, J, C), where they are known."""
        known = np.isfinite(self.sigma)
        total = float(np.sum(truth**2, where=known))
        off = float(np.sum((self.entries - truth) ** 2, where=known))
        return float(np.sqrt(off / total)) if total else np.inf


def solve_transport_slice(
    recipe: Recipe, shots: Mapping[str, ExposedShot], cells: CellMap, full: Bools | None = None
) -> TransportSlice:
    """The slice of a recipe of `pdcd.recipes.transport`, whose shots are all there.

    full : (h, w), quads that light has saturated (`pdcd.pictures.full`), None for none: cells with
    one are unknown.

    Raises DecodeError where the projector gave a cell no light of its own.
    """
    part = Slice.of(recipe.target.goal, recipe.target.grid)
    taken = [shots[shot.name] for shot in recipe.shots]
    lit: Bools = np.asarray(make_s_matrix(part.lit.size).any(axis=1))
    bright = [bool(np.all(lit[shot.only])) for shot in recipe.shots]
    gathered, shown, opened, uneven = _sides(taken, part, bright)
    known = ~np.logical_or.reduce([shot.saturated for shot in taken])
    sure = cells.seen(known)[part.seen] & (gathered > 0.0).all(axis=0)
    if full is not None:
        sure &= ~cells.touched(full)[part.seen]
    scale = np.divide(1.0, gathered, out=np.zeros_like(gathered), where=gathered > 0.0)
    found = unmix_some_cells(taken, known, cells, part.seen)
    light, error = found.light * scale[..., None], found.error * scale[..., None]
    system = np.concatenate([shown, opened[:, None]], axis=1)
    if np.linalg.matrix_rank(system) < system.shape[1]:
        raise DecodeError(
            "the photos do not tell the cells of the slice apart",
            hint="look at frames.csv: did the projector show every pattern",
        )
    inverse: Floats = np.linalg.pinv(system)
    solved, whatever = inverse[:-1], inverse[-1]
    total = float(light[:, sure].sum())
    common = float(opened.sum() * np.einsum("k,kcx->", whatever, light[:, sure]))
    entries = np.einsum("jk,kcx->cjx", solved, light)
    sigma = np.sqrt(np.einsum("jk,kcx->cjx", solved**2, error**2))
    sigma[~sure] = np.inf
    share = common / total if total > 0.0 else 0.0
    return TransportSlice(entries, sigma, part.seen, part.lit, len(taken), uneven, share)


def _sides(
    taken: list[ExposedShot], part: Slice, lit: list[bool]
) -> tuple[Floats, Floats, Floats, float]:
    """Both sides of the realised matrices: what cells gather (K, C), of mean 1 in each photo, what
    the projector showed (K, J) and for how long the mask was open (K,), both in seconds; and how
    far the matrices are from products. Photos that are not `lit` may be dark: a photo of a pattern
    without cells measures what all have in common."""
    gathered, shown, opened = [], [], []
    off = most = 0.0
    for shot, bright in zip(taken, lit, strict=True):
        open_s = shot.realised.open_s[part.seen]
        opened.append(float(open_s.mean()))
        whole = shot.realised.left[:, part.seen].T @ shot.realised.right[:, part.lit]
        total = float(whole.sum())
        if not bright and total == 0.0:
            gathered.append(open_s / opened[-1])
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


def draw_transport_slice(found: TransportSlice, title: str) -> NDArray[np.uint8]:
    """A slice to look at, (H, W, C) uint8: camera cells down, projector cells to the right.

    Brightness is logarithmic, from the noise or `_LEAST_GREY` of the brightest entries on, so that
    direct light, bands and single paths are all visible. What is not known is black.
    """
    known = np.isfinite(found.sigma)
    grey = found.entries[known.all(axis=2)]
    top = float(np.percentile(grey, _BRIGHT_PERCENT)) if grey.size else 1.0
    top = max(top, np.finfo(np.float64).tiny)
    noise = float(np.median(found.sigma[known])) if grey.size else 0.0
    low = min(max(noise / top, _LEAST_GREY), 0.1)

    def coded(share: Floats | float) -> NDArray[np.uint8]:
        """Share of the brightest entries -> pixel."""
        shade = 1.0 - np.log10(np.maximum(share, low)) / np.log10(low)
        return np.asarray(np.rint(255.0 * np.minimum(shade, 1.0)), np.uint8)

    drawn = np.where(known, coded(found.entries / top), np.uint8(0))
    factor = max(-(-_LEAST_PX // drawn.shape[1]), 1)
    drawn = drawn.repeat(factor, axis=0).repeat(factor, axis=1)
    marks = [(int(coded(g)), f"{g * top:.2g}") for g in _GREYS if g >= low]
    notes = ["down: camera cells", "right: projector cells", f"{found.photos} photos"]
    caption = draw_caption(drawn.shape[1], title, notes, marks)
    return np.concatenate([drawn, caption[..., : drawn.shape[2]]])
