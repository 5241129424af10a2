"""From tables of few numbers to the picture on the sensor: one gather for each sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.optics.products import COLOURS, Pairs
from pdcd.optics.setting import Setting, Tap
from pdcd.optics.sights import NOWHERE, CellGrid, Looks, Sights, pixels
from pdcd.scene.texture import sampled

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class Meetings:
    """The pairs that the sights of a frame are made of.

    direct : of mask and projector sites; `of_sight` (K,) which of them each sight is, or `NOWHERE`.
    indirect : of mask sites and scene cells; `of_corner` (K, corners) as `of_sight`.
    """

    direct: Pairs
    of_sight: Numbers
    indirect: Pairs
    of_corner: Numbers


def meetings(sights: Sights, cells: CellGrid) -> Meetings:
    """The distinct pairs of all sights."""
    seen = sights.place >= 0
    direct, of_sight = _pairs(sights.mask, sights.lit, seen & (sights.lit >= 0))
    corners = cells.corners[np.maximum(sights.place, 0)]
    count = corners.shape[1]
    indirect, of_corner = _pairs(np.repeat(sights.mask, count), corners.ravel(), seen.repeat(count))
    return Meetings(direct, of_sight, indirect, of_corner.reshape(-1, count))


def _pairs(mask: Numbers, other: Numbers, used: NDArray[np.bool_]) -> tuple[Pairs, Numbers]:
    width = int(other.max(initial=0)) + 1
    keys, inverse = np.unique((mask * width + other)[used], return_inverse=True)
    of = np.full(mask.size, NOWHERE, dtype=np.int64)
    of[used] = inverse
    return Pairs(*np.divmod(keys, width)), of


@dataclass(frozen=True)
class Picture:
    """All that a picture is rendered from.

    direct : (pairs,) of `Meetings.direct`, what the cells' direct reflection is multiplied by.
    reflected : (N, 3) that reflection; with a texture, over the texture's means.
    indirect : (pairs, 3) of `Meetings.indirect`; with a texture, over its means.
    textures : of the direct and of the indirect light, (H, W, 3) each, or None.
    ambient : how long each mask site is open (S,), and the ambient light of the cells (N, 3).
    uneven : (height, width) light of each projector pixel over that of the brightest, or None.
    """

    direct: Floats
    reflected: Floats
    indirect: Floats
    textures: tuple[Floats, Floats] | None = None
    ambient: tuple[Floats, Floats] | None = None
    uneven: Floats | None = None


class Renderer:
    """Renders pictures of one geometry."""

    def __init__(self, setting: Setting, looks: Looks, cells: CellGrid) -> None:
        self._setting, self._looks, self._cells = setting, looks, cells
        self._plain = CellGrid(cells.grid, smooth=False)

    def render(self, sights: Sights, met: Meetings, picture: Picture) -> Floats:
        """Mean light of each quad, (rows, cols, 3)."""
        rows, cols = self._setting.frame
        per_quad = self._setting.samples
        image = np.empty((rows, cols, COLOURS))
        both = self._values(sights, met, picture)
        same = picture.textures is None or picture.textures[0] is picture.textures[1]
        # Where nothing but the cells' light tells them apart, one gather brings both.
        split = picture.uneven is not None or not same
        direct, indirect = both if split else (None, both[0] + both[1])
        for number, chunk in enumerate(self._looks.chunks()):
            light = self._chunk(sights, picture, number, chunk, direct, indirect)
            whole = light.reshape(chunk[1] - chunk[0], per_quad, cols, per_quad, COLOURS)
            image[chunk[0] : chunk[1]] = whole.sum(axis=(1, 3)) / per_quad**2
        return image

    def _values(self, sights: Sights, met: Meetings, picture: Picture) -> tuple[Floats, Floats]:
        """Direct and indirect light of each sight's corners, (K, corners, 3) each."""
        lit = np.append(picture.direct, 0.0)[met.of_sight]
        corners = self._cells.corners[np.maximum(sights.place, 0)]
        direct = lit[:, None, None] * picture.reflected[corners]
        indirect = np.append(picture.indirect, np.zeros((1, COLOURS)), axis=0)[met.of_corner]
        return direct, indirect

    def _chunk(
        self,
        sights: Sights,
        picture: Picture,
        number: int,
        chunk: tuple[int, int],
        direct: Floats | None,
        indirect: Floats,
    ) -> Floats:
        """Light of the samples of one chunk, (n, 3)."""
        setting = self._setting
        count = (chunk[1] - chunk[0]) * setting.frame[1] * setting.samples**2
        light = np.zeros((count, COLOURS))
        detailed = picture.textures is not None or picture.ambient is not None
        x, y = self._looks.on_field(chunk) if detailed else (np.zeros(0), np.zeros(0))
        for which, (tap, runs) in enumerate(zip(setting.taps, sights.runs[number], strict=True)):
            sight = runs.spread(count)
            part = self._detail(picture, 1, indirect[sight], tap, x, y)
            if direct is not None:
                lit = self._detail(picture, 0, direct[sight], tap, x, y)
                if picture.uneven is not None:
                    place = self._looks.on_projector(chunk, which)
                    lit *= pixels(picture.uneven, *place, missing=0.0)[:, None]
                part += lit
            if len(setting.taps) > 1:
                part *= tap.share
            light += part
        if picture.ambient is not None:
            open_s, ambient = picture.ambient
            cell = self._plain.at(x, y)
            before = sights.mask[sights.runs[number][0].spread(count)]
            there = np.append(ambient, np.zeros((1, COLOURS)), axis=0)[cell]
            light += open_s[before][:, None] * there
        return light

    def _detail(
        self, picture: Picture, which: int, corners: Floats, tap: Tap, x: Floats, y: Floats
    ) -> Floats:
        """Light of samples (n, 3) out of that of their corners, (n, corners, 3)."""
        if picture.textures is None:
            return np.ascontiguousarray(corners[:, 0])
        across, down = x + tap.offset[0], y + tap.offset[1]
        shares = self._cells.shares(across, down)
        smooth: Floats = np.einsum("nk,nkc->nc", shares, corners)
        smooth *= sampled(picture.textures[which], np.stack([across, down], axis=-1))
        return smooth
