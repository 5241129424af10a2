"""Pictures of panels whose pixels have few histories: each sample is looked up in one table.

Under patterns of pixels hardly any two quads have the same sights, so nothing can be kept from one
picture to the next. But the pixels have few different histories
(`pdcd.virtual.optics.histories`): a table of all pairs of histories is small, and a picture takes
one look-up a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.panels.draw import WHITE_BYTE
from pdcd.panels.frames import Frames
from pdcd.panels.patterns import read_pattern_bytes
from pdcd.virtual.optics.setting import OpticalSetting
from pdcd.virtual.optics.sights import CameraSamples, CellGrid, pick_pixel_values
from pdcd.virtual.scene.texture import sample_texture

MOST_PAIRS = 1 << 22
"""Largest table of pairs that is made."""
_SPARSE = 1.0 / 64.0
"""Below this share of lit and open paths between pixels of both panels, pictures are sparse."""


@dataclass(frozen=True)
class HistoryTables:
    """The histories of pixels, and the light that pairs of histories pass.

    mask, projector : (height, width) int32, the history of each pixel.
    beside : history of what lies beside the mask.
    seconds : (M, P) for how long a mask history was open while a projector history was lit.
    sent : (M, N, 3) indirect light of a cell through a mask history; None where there is none.
    open_s : (M,) for how long mask histories were open.
    uneven : (height, width) light of each projector pixel, relative to the brightest; None: all
        pixels are alike.
    """

    mask: NDArray[np.int32]
    projector: NDArray[np.int32]
    beside: int
    seconds: Floats
    sent: Floats | None
    open_s: Floats
    uneven: Floats | None


def render_by_lookup(
    setting: OpticalSetting,
    looks: CameraSamples,
    cells: CellGrid,
    whole: HistoryTables,
    scene: tuple[Floats, ...],
    textures: tuple[Floats, Floats] | None = None,
) -> Floats:
    """Mean light of each quad, (rows, cols, 3).

    scene : direct reflection of the cells (N, 3); then their ambient light (N, 3), if there is any.
    textures : of direct and of indirect light, (H, W, 3) each, which multiply the cells' light
        from place to place; the reflection and `whole.sent` are then divided by their means.
    """
    (rows, cols), per_quad = setting.frame, setting.samples
    reflected, *ambient = (_grey(part) for part in scene)
    # One more history of the projector, for what lies beside it: that is never lit.
    seconds = np.append(whole.seconds, np.zeros((len(whole.seconds), 1)), axis=1)
    unlit = seconds.shape[1] - 1
    of_textures = textures or (None, None)
    plain = CellGrid(cells.grid, smooth=False)
    grey = whole.sent is None and textures is None
    colours = max(part.shape[1] for part in (reflected, *ambient)) if grey else 3
    image = np.empty((rows, cols, 3))
    for chunk in looks.chunks():
        x, y = looks.on_field(chunk)
        before = pick_pixel_values(whole.mask, looks.mask_pixels(chunk), missing=whole.beside)
        open_s = whole.open_s[before]
        light = np.zeros((x.size, colours))
        for number, tap in enumerate(setting.taps):
            at = looks.lit_pixels(chunk, number)
            behind = pick_pixel_values(whole.projector, at, missing=unlit)
            lit = seconds[before, behind]
            if whole.uneven is not None:
                lit *= pick_pixel_values(whole.uneven, at, missing=0.0)
            places = x + tap.offset[0], y + tap.offset[1]
            here = _Here.of(cells, places, lit > 0.0)
            strength = tap.share * lit[here.points, None]
            light[here.points] += strength * here.mean(reflected) * here.detail(of_textures[0])
            if whole.sent is not None:
                here = _Here.of(cells, places, open_s > 0.0)
                wandered = here.mean(whole.sent, before) * here.detail(of_textures[1])
                light[here.points] += tap.share * wandered
        if ambient:
            here = _Here.of(plain, (x, y), open_s > 0.0)
            light[here.points] += open_s[here.points, None] * here.mean(ambient[0])
        quads = light.reshape(chunk[1] - chunk[0], per_quad, cols, per_quad, -1)
        image[chunk[0] : chunk[1]] = quads.mean(axis=(1, 3))
    return image


@dataclass(frozen=True)
class _Here:
    """Points that lie on the field, and the cells that count there.

    points : (n,) which points.
    places : (n, 2) where they lie on the field.
    cells : (n, corners); shares : (n, corners) how much each counts; None: one cell a point.
    """

    points: NDArray[np.intp]
    places: Floats
    cells: NDArray[np.integer]
    shares: Floats | None

    @classmethod
    def of(cls, grid: CellGrid, places: tuple[Floats, Floats], used: NDArray[np.bool_]) -> _Here:
        """Those of the places, x and y (m,) each, that are `used` (m,) and lie on the field."""
        points = np.flatnonzero(used)
        x, y = (one[points] for one in places)
        place = grid.at(x, y)
        inside = place >= 0
        if not inside.all():
            points, x, y, place = points[inside], x[inside], y[inside], place[inside]
        there = np.stack([x, y], axis=-1)
        if not grid.smooth:
            return cls(points, there, place[:, None], None)
        return cls(points, there, grid.corners[place], grid.shares(x, y))

    def mean(self, values: Floats, first: NDArray[np.integer] | None = None) -> Floats:
        """Values (n, C) there, from values of cells (N, C) or (M, N, C); `first` (m,) is then the
        index into M of each of all points."""
        rows = self.cells
        if first is not None:
            rows = rows + first[self.points, None].astype(np.int64) * values.shape[1]
            values = values.reshape(-1, values.shape[-1])
        if self.shares is None:
            return values.take(rows[:, 0], axis=0)
        return np.asarray(np.einsum("nk,nkc->nc", self.shares, values.take(rows, axis=0)))

    def detail(self, texture: Floats | None) -> Floats | float:
        """What a texture makes of light there, (n, 3)."""
        return 1.0 if texture is None else sample_texture(texture, self.places)


def _grey(light: Floats) -> Floats:
    """The light (N, 3), as (N, 1) where all colours are the same."""
    return light[:, :1] if np.array_equal(light, np.repeat(light[:, :1], 3, axis=1)) else light


def is_sparse(frames: Frames) -> bool:
    """Whether patterns of pixels leave nearly all of both panels dark, so that few samples of a
    quad would see any light."""
    shares = []
    for patterns in (frames.primal_patterns, frames.dual_patterns):
        if not len(patterns):
            return False
        cells = patterns.shape[1] * (8 if patterns.dtype == np.uint8 else 1)
        shown = (read_pattern_bytes(patterns, number, cells) for number in range(len(patterns)))
        shares.append(max(float(one.mean()) / WHITE_BYTE for one in shown))
    return shares[0] * shares[1] < _SPARSE
