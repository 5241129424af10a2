"""A look at where both panels lie: two photos of random blocks before the codes.

Codes on a mask that lies elsewhere give a photo that looks like any other one, and error bars do
not show it. The blocks are drawn on both panels as codes are, by the maps that are believed in;
`pdcd.pictures.misplaced` says what follows from the photos.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config
from pdcd.panels.blocks import BlockPattern, find_field_pixels
from pdcd.panels.frames import PIXEL_WINDOW, Frames
from pdcd.panels.patterns import pack_bits
from pdcd.planning.plan import Plan, has_code_mask
from pdcd.recipes.recipe import Shot

_LOOK_S = 0.5
"""Longest time for which a photo of blocks is shown: that of the white shot if that is shorter."""
WHITE_BLOCK_PHOTO, PROJECTOR_BLOCK_PHOTO, MASK_BLOCK_PHOTO = (
    "look-white",
    "look-projector",
    "look-mask",
)
"""The photos, as their RAW files are called; the first only where a run has no white shot."""


OFF_AXIS = "on an off-axis bench direct light comes from elsewhere, so that blocks do not show it"
"""Why panels cannot be checked."""


def is_panel_check_needed(plan: Plan, config: Config) -> bool:
    """Whether it matters to the photos of a plan that both panels lie alike."""
    coded = any(has_code_mask(program) for program in plan.recipe.programs.values())
    return coded and config.rig.look_at_panels


def find_white_shot(plan: Plan) -> Shot | None:
    """The shot of a plan with all light, with which the photos of blocks are compared."""
    return next((s for s in plan.recipe.shots if s.all_light and not s.beside), None)


def is_panel_check_due(plan: Plan, taken: Collection[str]) -> bool:
    """Whether the look comes next: after the white shot, where there is one."""
    white = find_white_shot(plan)
    return white is None or white.name in taken


def count_block_rows(plan: Plan) -> int:
    """Refreshes of each photo: at the aperture of the shot it is compared with, it gets no more
    light than that one, which was metered."""
    shot = find_white_shot(plan) or plan.last_exposed
    most = max(2, round(_LOOK_S * plan.row_hz))
    return max(1, min(most, int(plan.refreshes(shot) * plan.light_share(shot))))


@dataclass(frozen=True)
class BlockFrames:
    """What the photos show: `blocks` for so many `rows`."""

    config: Config
    blocks: BlockPattern
    rows: int

    def frames(self, name: str) -> Frames:
        """Refreshes of a photo. Panels show nothing outside the field, as in white shots."""
        panels, patterns = panels_of(self.config), []
        for panel, blocks_on in (
            (panels.projector, PROJECTOR_BLOCK_PHOTO),
            (panels.mask, MASK_BLOCK_PHOTO),
        ):
            shown = (
                self.blocks.drawn(panel.map) if name == blocks_on else find_field_pixels(panel.map)
            )
            patterns.append(pack_bits(shown.reshape(1, -1)))
        index = np.zeros(self.rows, dtype=np.int32)
        return Frames(
            primal_patterns=patterns[0],
            dual_patterns=patterns[1],
            primal_index=index,
            dual_index=index.copy(),
            shift=np.zeros(self.rows, dtype=np.uint8),
            code=np.arange(self.rows, dtype=np.int32),
            guard=np.zeros(self.rows, dtype=np.bool_),
            grid=(1, 1),
            lattice=(1, 1),
            window=PIXEL_WINDOW,
        )
