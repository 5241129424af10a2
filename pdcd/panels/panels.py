"""A panel as drawing sees it: which of the two it is, and where its pixels lie."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pdcd.panels.map import Map


@dataclass(frozen=True)
class PanelView:
    """One panel; `map` knows its size and where its pixels lie on the field."""

    role: Literal["projector", "mask"]
    map: Map

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.map.size_px

    @property
    def mask(self) -> bool:
        """Whether it is the mask, which has windows and blocks light."""
        return self.role == "mask"
