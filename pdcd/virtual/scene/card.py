"""A flat matt card: what a bench is calibrated on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pdcd.errors import ConfigError
from pdcd.virtual.scene.effects import Direct
from pdcd.virtual.scene.scene import Scene

CARD = "card"
"""What `[scene] kind` calls it."""
ALBEDO = 0.9
"""Of white paper."""


def card(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """A card that fills the field. Options: `albedo`, its reflectance, 0 to 1.

    Raises ConfigError for other options, or an albedo that is none.
    """
    unknown = sorted(set(options) - {"albedo"})
    albedo = options.get("albedo", ALBEDO)
    number = isinstance(albedo, int | float) and not isinstance(albedo, bool)
    if unknown or not number or not 0.0 < albedo <= 1.0:
        raise ConfigError(
            f"[scene] options of 'card': {', '.join(unknown) or f'albedo = {albedo!r}'}",
            hint="`albedo` alone, above 0 and at most 1",
        )
    cells = grid[0] * grid[1]
    return Scene("card", grid, (Direct("card", np.full(cells, float(albedo))),))
