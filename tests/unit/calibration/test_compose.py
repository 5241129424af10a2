"""Mask to projector by way of the camera, and one field for all three."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pdcd.calibration.geometry.compose import compose_maps
from pdcd.calibration.geometry.fit import FittedMap, PointPairs, fit_map
from pdcd.errors import CalibrationError
from pdcd.panels.map import map_between
from tests.unit.calibration.geometry_bench import Way

FRAME = (1424, 2136)
PROJECTOR = Way((1024, 768), FRAME, turn_deg=2.0, keystone=(0.05, -0.03))
MASK = Way((1600, 1200), FRAME, scale=1.13, turn_deg=180.5, keystone=(0.01, 0.0))


def seen(way: Way, sigma_px: float, seed: int) -> FittedMap:
    """The camera's map to a panel, out of dots with noise."""
    rng = np.random.default_rng(seed)
    source = rng.uniform(0.0, 1.0, (1500, 2)) * (FRAME[1], FRAME[0])
    target = way.to_panel(source)
    inside = ((target > 0.0) & (target < way.size_px)).all(axis=-1)
    noisy = target[inside] + rng.normal(0.0, sigma_px, target[inside].shape)
    pairs = PointPairs(source[inside], noisy, np.full(noisy.shape, sigma_px))
    return fit_map(pairs, (FRAME[1], FRAME[0]), way.size_px, "panel")


def places() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Quads that see both panels, and their pixels of mask and projector."""
    quads = np.random.default_rng(7).uniform(0.05, 0.95, (3000, 2)) * (FRAME[1], FRAME[0])
    mask, projector = MASK.to_panel(quads), PROJECTOR.to_panel(quads)
    both = ((mask > 0.0) & (mask < MASK.size_px)).all(axis=-1)
    both &= ((projector > 0.0) & (projector < PROJECTOR.size_px)).all(axis=-1)
    return quads[both], mask[both], projector[both]


@pytest.mark.long
def test_the_composed_map_is_the_way_from_mask_to_projector() -> None:
    _, mask, projector = places()
    ratios = []
    for seed in range(3):
        found = compose_maps(seen(PROJECTOR, 0.03, seed), seen(MASK, 0.04, 100 + seed))
        error = found.mask.to_target(mask) - projector
        assert np.percentile(np.hypot(*error.T), 95.0) < 0.03
        ratios.append(error / found.sigma_px(mask))
        # What composing itself leaves is small beside that.
        assert np.percentile(np.abs(found.mask.residual_px), 95.0) < 0.003
    assert 0.75 < np.concatenate(ratios).std() < 1.25


def test_one_field_holds_all_three() -> None:
    maps = compose_maps(seen(PROJECTOR, 0.01, 1), seen(MASK, 0.01, 2)).maps
    quads, mask, projector = places()
    for one, other, at, there, off_px in (
        ("camera", "projector", quads, projector, 0.02),
        ("mask", "projector", mask, projector, 0.02),
        ("camera", "mask", quads, mask, 0.04),
    ):  # fmt: skip
        off = np.abs(map_between(maps[one], maps[other], at) - there)
        assert np.percentile(off, 95.0) < off_px


def test_panels_that_do_not_meet_are_refused() -> None:
    left = seen(replace(PROJECTOR, scale=0.6, shift_quads=(-700.0, 0.0)), 0.01, 1)
    right = seen(replace(MASK, scale=0.4, shift_quads=(700.0, 0.0)), 0.01, 2)
    with pytest.raises(CalibrationError, match="shows both"):
        compose_maps(left, right)
