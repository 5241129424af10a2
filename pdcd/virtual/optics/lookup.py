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
from pdcd.virtual.optics.products import SitePairs
from pdcd.virtual.optics.setting import OpticalSetting
from pdcd.virtual.optics.sights import CameraSamples, CellGrid, pick_pixel_values
from pdcd.virtual.scene.texture import sample_texture

MOST_PAIRS = 1 << 21
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


def list_all_pairs(first: int, second: int) -> SitePairs:
    """All pairs of `first` mask histories and `second` other things, in the order of a table."""
    return SitePairs(np.repeat(np.arange(first), second), np.tile(np.arange(second), first))


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
    plain, nothing = CellGrid(cells.grid, smooth=False), np.zeros((1, 3))
    reflected, *ambient = (_grey(np.append(part, nothing, axis=0)) for part in scene)
    # One more history of the projector, for what lies beside it: that is never lit.
    seconds = np.append(whole.seconds, np.zeros((len(whole.seconds), 1)), axis=1)
    unlit = seconds.shape[1] - 1
    sent = None
    if whole.sent is not None:
        sent = np.append(whole.sent, np.zeros((len(whole.sent), 1, 3)), axis=1)
    colours = 3 if sent is not None or textures is not None else reflected.shape[1]
    image = np.empty((rows, cols, 3))
    for chunk in looks.chunks():
        x, y = looks.on_field(chunk)
        before = pick_pixel_values(whole.mask, looks.mask_pixels(chunk), missing=whole.beside)
        light = np.zeros((x.size, colours))
        for number, tap in enumerate(setting.taps):
            at = looks.lit_pixels(chunk, number)
            behind = pick_pixel_values(whole.projector, at, missing=unlit)
            lit = seconds[before, behind] * tap.share
            if whole.uneven is not None:
                lit *= pick_pixel_values(whole.uneven, at, missing=0.0)
            places = np.stack([x + tap.offset[0], y + tap.offset[1]], axis=-1)
            here = _Here.of(cells, places)
            direct = lit[:, None] * here.mean(reflected)
            light += direct if textures is None else direct * sample_texture(textures[0], places)
            if sent is not None:
                wandered = tap.share * here.mean(sent, before)
                light += (
                    wandered if textures is None else wandered * sample_texture(textures[1], places)
                )
        if ambient:
            there = whole.open_s[before][:, None] * ambient[0][plain.at(x, y)]
            light = light + there
        quads = light.reshape(chunk[1] - chunk[0], per_quad, cols, per_quad, -1)
        image[chunk[0] : chunk[1]] = quads.mean(axis=(1, 3))
    return image


@dataclass(frozen=True)
class _Here:
    """Which cells count at points, (n, corners), and how much each of them counts, (n, corners);
    None: one cell a point."""

    cells: NDArray[np.integer]
    shares: Floats | None

    @classmethod
    def of(cls, grid: CellGrid, points: Floats) -> _Here:
        """At points (n, 2) of the field; a point beside it gets the entry after the last cell."""
        x, y = points[:, 0], points[:, 1]
        place = grid.at(x, y)
        if not grid.smooth:
            return cls(place, None)
        beside = grid.grid[0] * grid.grid[1]
        corners = np.append(grid.corners, np.full((1, 4), beside), axis=0)
        return cls(corners[place], grid.shares(x, y))

    def mean(self, values: Floats, first: NDArray[np.integer] | None = None) -> Floats:
        """Values (n, C) at the points, from values of cells (N + 1, C) or (M, N + 1, C); `first`
        is then each point's index into M."""
        if self.shares is None:
            return np.asarray(values[self.cells] if first is None else values[first, self.cells])
        found = values[self.cells] if first is None else values[first[:, None], self.cells]
        return np.asarray(np.einsum("nk,nkc->nc", self.shares, found))


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
