"""The pixels of a photo of strips, held against points looked at one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.bench.placed import place_panels
from pdcd.bench.tables import PanelConfig
from pdcd.panels.placing import Placing
from pdcd.probing.borders import APART, find_border_pixels

GRID = (5, 7)
PROJECTOR_PX = (88, 66)
BENCHES: list[dict[str, Any]] = [
    {"size_px": (137, 102)},
    {"size_px": (149, 113), "place": Placing(flip="horizontal")},
    {"size_px": (137, 102), "place": Placing(turn_deg=4.0, scale=1.2)},
]


MARGIN_PX = 0.25


@pytest.mark.parametrize("off_px", [(0.0, 0.0), (0.15, -0.15)])
@pytest.mark.parametrize("mask", BENCHES)
def test_light_gets_through_strips_alone_and_through_each_once(
    mask: dict[str, Any], off_px: tuple[float, float]
) -> None:
    """Also where the mask lies a little elsewhere than it is believed to."""
    panels = place_panels(PanelConfig(size_px=PROJECTOR_PX), PanelConfig(**mask))
    pixels = find_border_pixels(panels.projector, panels.mask, GRID, MARGIN_PX)
    points = np.random.default_rng(1).uniform(size=(60_000, 2))
    shown, at = [], []
    for view in (panels.projector, panels.mask):
        moved = points + (view is panels.mask) * np.array(off_px) / PROJECTOR_PX
        pixel = np.floor(view.map.from_field(moved)).astype(np.int64)
        on = np.all((pixel >= 0) & (pixel < view.size_px), axis=1)
        cell = np.floor(view.map.to_field(pixel + 0.5) * GRID[::-1]).astype(np.int64)
        on &= np.all((cell >= 0) & (cell < GRID[::-1]), axis=1)
        shown.append(np.where(on, cell[:, 1] * GRID[1] + cell[:, 0], -1))
        at.append((np.where(on, pixel[:, 1], 0), np.where(on, pixel[:, 0], 0)))
    there = (shown[0] >= 0) & (shown[1] >= 0)
    apart = there & (shown[0] != shown[1])
    times = np.zeros(len(points), dtype=np.int64)
    kinds = list(pixels.of_kinds())
    for lit, opened in kinds:
        times += lit[at[0]] & opened[at[1]]
    lit_beside = list(pixels.of_kinds(inner=True))
    assert not any((lit[at[0]] & opened[at[1]]).any() for lit, opened in lit_beside)
    assert len(kinds) == APART**2
    assert np.mean(apart) > 0.01
    assert not times[there & ~apart].any()
    assert times.max() == 1
    assert np.mean(times[apart] == 1) > 0.999
    # As many pixels next to those beside borders, so that as much light comes from near.
    beside, inner = (np.mean([lit.mean() for lit, _ in each]) for each in (kinds, lit_beside))
    assert inner == pytest.approx(beside, rel=0.3)
