"""The cells of a program on the field of the scene: where the projector shows them.

A scene fills the projector's whole picture; codes fill the part of it that all devices are believed
to share. The true picture depends on the cells of its codes: those decide what counts as direct
light, not the cells that a scene is described in.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.virtual.optics.setting import OpticalSetting, find_points_on_field
from pdcd.virtual.optics.sights import NO_SITE, CellGrid

CLOSED = 0
"""The number of places whose light does not get to the camera; cell n of the codes is n + 1."""


@dataclass(frozen=True)
class OwnCells(CellGrid):
    """The cells of codes, used as a mask that lets nothing pass beside their field."""

    setting: OpticalSetting = field(compare=False, repr=False)

    @classmethod
    def of(cls, setting: OpticalSetting, grid: tuple[int, int]) -> OwnCells:
        """The cells of a program whose grid has these rows and columns."""
        return cls(grid, smooth=False, setting=setting)

    def on_field(self, points: Floats) -> Floats:
        """Points (..., 2) of the scene's field -> of the field that the codes fill."""
        return self.setting.drawn.projector.map.to_field(self.setting.on_projector(points))

    def passes(self, seen: Floats) -> NDArray[np.bool_]:
        """Which points of the scene's field (n, 2) lie in that of the codes."""
        return np.asarray(self.at(*self.on_field(seen).T) != NO_SITE)

    def before(
        self, passed: NDArray[np.bool_], lit: tuple[Floats, Floats], lit_px: tuple[Floats, Floats]
    ) -> NDArray[np.int32]:
        """Cells of the points that the pixels `lit_px` light, as numbers from 1 on; `CLOSED` where
        they are not seen. Light that a blur brings from beside the field counts to the nearest
        cell. On the axis pixels light what lies behind them; there are no own cells off it."""
        places = self.setting.drawn.projector.map.to_field(np.stack(lit_px, axis=-1))
        with np.errstate(invalid="ignore"):
            nearest = np.clip(np.nan_to_num(places), 0.0, np.nextafter(1.0, 0.0))
        return np.where(passed, self.at(*nearest.T) + 1, CLOSED).astype(np.int32)

    def inside(self, points: Floats) -> NDArray[np.bool_]:
        """Which points (..., 2) of the scene's field lie in that of the codes."""
        return find_points_on_field(self.on_field(points))


def find_own_cells(
    setting: OpticalSetting, of_scene: tuple[int, int], grid: tuple[int, int]
) -> OwnCells | None:
    """The cells of a program; None where they are the scene's own, `of_scene`."""
    if grid == of_scene and setting.drawn.projector.map == setting.panels.projector.map:
        return None
    return OwnCells.of(setting, grid)
