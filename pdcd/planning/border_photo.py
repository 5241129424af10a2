"""A photo of the direct light that gets through along the borders of whole cells, and as far as
panels allow of nothing else.

Where both panels draw the border of a cell in two places, the light of one cell goes through the
mask of the next one (`pdcd.probing.borders`). Here the projector lights only the pixels beside
borders, and the mask opens those on the other side, for one cell out of sixteen at a time. A lit
pixel then overlaps an open one only in a strip, wherever both panels really lie. So each quad
measures how bright its strips are, with all the detail that they have.

Indirect light gets in, too, most of it from near. As much of it gets into a second photo, for which
the projector lights the pixels next to those, which do not overlap with open ones. In a third photo
the projector is black: it shows how much of the second is indirect light.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config
from pdcd.panels.frames import BLACK, PIXEL_WINDOW, Frames
from pdcd.panels.patterns import pack_bits
from pdcd.planning.panel_look import count_block_rows, find_white_shot
from pdcd.planning.plan import Plan
from pdcd.probing.borders import (
    LEAST_APART,
    BorderPixels,
    compute_cell_mismatch_share,
    find_border_pixels,
    measure_border_reach,
)

LIT, INNER, DARK = "look-borders", "look-borders-inner", "look-borders-dark"
"""The photos, as their RAW files are called."""

BORDER_PHOTO_S = 0.2
"""Longest time for which strips of each of sixteen kinds are shown."""
_MARGIN_PX, _BLURRED = 0.25, 2.0
"""Least distance, in projector pixels, by which a panel may lie elsewhere than believed; and how
far what it shows is spread, over its blur."""
_MOST_REACH = 1.0 / 3.0
"""Largest reach in cells: beyond it, pixels next to those beside a border lie at the next one."""
_SHORTER = 3
"""How much shorter the other two photos are: they have so little light that noise is no matter."""


def is_border_photo_needed(plan: Plan, config: Config) -> bool:
    """Whether a plan takes a photo of indirect light through whole cells whose borders do not
    coincide, and a white one."""
    shots = {shot.name: shot for shot in plan.recipe.shots}
    through = (
        shots[name]
        for photo in plan.recipe.photos
        if photo.wanted.uniform == (0.0, 1.0)
        for _, name in photo.shots
        if name in shots
    )
    if find_white_shot(plan) is None or not any(plan.window_of(s) == "whole" for s in through):
        return False
    panels = panels_of(config)
    views = panels.projector, panels.mask, plan.grid
    return (
        max(measure_border_reach(*views, _margin_px(config))) <= _MOST_REACH
        and compute_cell_mismatch_share(*views) >= LEAST_APART
    )


def _margin_px(config: Config) -> float:
    """Projector pixels beyond the pixels of both panels at which light gets through."""
    return max(_MARGIN_PX, config.rig.misregistration_px) + _BLURRED * config.mask.blur_px


def is_border_photo_due(plan: Plan, taken: Collection[str]) -> bool:
    """Whether the photo comes next: after the white one, which sets how long it is shown."""
    white = find_white_shot(plan)
    return white is not None and white.name in taken


@dataclass(frozen=True, eq=False)
class BorderFrames:
    """What the photo shows: strips of each kind for so many `rows`, and a `pause` after them."""

    pixels: BorderPixels
    rows: int
    pause: int
    row_hz: float

    @classmethod
    def of(cls, plan: Plan, config: Config, widest: float) -> BorderFrames:
        """The frames of a plan. At the aperture of the white shot the brightest quad, of which
        strips take the share `widest`, gets no more light than in that shot."""
        panels = panels_of(config)
        pixels = find_border_pixels(panels.projector, panels.mask, plan.grid, _margin_px(config))
        pause = max(2, math.ceil(plan.settle_s * plan.row_hz))
        most = max(2, round(BORDER_PHOTO_S * plan.row_hz))
        rows = max(1, min(most, int(count_block_rows(plan) / max(widest, 1e-6))))
        return cls(pixels, rows, pause, plan.row_hz)

    def phase_s(self, name: str) -> float:
        """For how long strips of each kind are shown in a photo."""
        return self._rows(name) / self.row_hz

    def frames(self, name: str) -> Frames:
        """Refreshes of a photo."""
        shown = zip(*self.pixels.of_kinds(inner=name == INNER), strict=True)
        patterns = [pack_bits(np.stack(kinds).reshape(len(kinds), -1)) for kinds in shown]
        rows = self._rows(name)
        each = np.full((len(patterns[0]), rows + self.pause), BLACK, dtype=np.int32)
        each[:, :rows] = np.arange(len(each))[:, None]
        index = each.ravel()
        return Frames(
            primal_patterns=patterns[0],
            dual_patterns=patterns[1],
            primal_index=np.full_like(index, BLACK) if name == DARK else index,
            dual_index=index,
            shift=np.zeros(index.size, dtype=np.uint8),
            code=np.arange(index.size, dtype=np.int32),
            guard=index == BLACK,
            grid=(1, 1),
            lattice=(1, 1),
            window=PIXEL_WINDOW,
        )

    def _rows(self, name: str) -> int:
        return self.rows if name == LIT else max(1, self.rows // _SHORTER)
