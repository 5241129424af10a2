"""What the panels show for the measurement of light, and for how long it lasts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdcd.calibration.shown import NO_PATTERNS, PanelSequence
from pdcd.panels.frames import BLACK, WHITE

COVERED = ("C", "C-again")
"""Photos for which somebody covers the projector's lens."""
DARK_LEVEL, LIGHT_LEVEL = 16, 239
"""Levels next to black and white, which a panel of limited range, 16 to 235, shows like these."""
DARK_TIMES = 2
"""Photos of the dark level last so many times as long as WW."""


@dataclass(frozen=True)
class LightPlan:
    """What to show.

    refreshes : of white light in WW. longer : how many times as many in all other photos.
    lead : refreshes for which the mask is open before and after the light.
    refresh_s : duration of one.
    """

    refreshes: int = 60
    longer: int = 8
    lead: int = 6
    refresh_s: float = 1.0 / 60.0

    def photos(self) -> tuple[PanelSequence, ...]:
        """The series, in the order in which to take it; the last two with the projector covered.

        All but BB are taken twice: this shows changes of light, and a shutter that did not open.
        """
        white, black, long = WHITE, BLACK, self.longer
        return (
            self._shown("WW", white, white, 1),
            self._shown("BW", black, white, long),
            self._shown("WB", white, black, long),
            self._shown("BB", black, black, long),
            self._shown("WB-again", white, black, long),
            self._shown("BW-again", black, white, long),
            self._shown("WW-again", white, white, 1),
            self._shown("C", black, white, long),
            self._shown("C-again", black, white, long),
        )

    def _shown(self, name: str, projector: int, mask: int, times: int) -> PanelSequence:
        light = np.full(self.refreshes * times + 2 * self.lead, BLACK, np.int32)
        light[self.lead : -self.lead] = projector
        opened = np.full(light.size, mask, np.int32)
        return PanelSequence(name, NO_PATTERNS, NO_PATTERNS, light, opened)

    def levels(self, sizes: tuple[tuple[int, int], tuple[int, int]]) -> tuple[PanelSequence, ...]:
        """Each panel uniform at a level next to black, and next to white, with the other one white:
        "dark-projector", "dark-mask", "light-projector", "light-mask".

        sizes : (width, height) of projector and mask.
        """
        return tuple(
            self._level(end, level, times, panel, sizes[panel])
            for end, level, times in (
                ("dark", DARK_LEVEL, DARK_TIMES), ("light", LIGHT_LEVEL, 1),
            )
            for panel in (0, 1)
        )  # fmt: skip

    def _level(
        self, end: str, level: int, times: int, panel: int, size: tuple[int, int]
    ) -> PanelSequence:
        whole = self._shown(f"{end}-{('projector', 'mask')[panel]}", WHITE, WHITE, times)
        pattern = np.full((1, size[1], size[0]), level, np.uint8)
        if panel:
            return replace(whole, mask=pattern, mask_index=np.zeros_like(whole.mask_index))
        light = np.where(whole.projector_index == WHITE, 0, BLACK).astype(np.int32)
        return replace(whole, projector=pattern, projector_index=light)

    def lit_s(self, times: int, excess_s: float = 0.0) -> float:
        """D: for how long a white projector gives its light; excess_s is its fall - rise."""
        return self.refreshes * times * self.refresh_s + excess_s

    def open_s(self, times: int, excess_s: float = 0.0) -> float:
        """M: the same of an open mask."""
        return (self.refreshes * times + 2 * self.lead) * self.refresh_s + excess_s


@dataclass(frozen=True)
class PulseEdges:
    """What the panels' edges add to any time: fall - rise, in s, and its standard deviation.

    The series of `pdcd.calibration.sensor.body` measures the projector's; a few ms are usual.
    """

    projector_s: float
    mask_s: float
    sigma_s: float
