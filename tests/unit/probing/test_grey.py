"""The realised matrix of grey levels: what light 8 bits give, worked out level by level."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.bench.tables import PanelConfig
from pdcd.panels.curve import make_power_curve, make_table_curve
from pdcd.panels.draw import draw
from pdcd.panels.schedule import build_frames
from pdcd.probing.panel import PanelOptics
from pdcd.probing.pixel_matrix import compute_pixel_factors
from pdcd.probing.realised import collect_factors, compute_bench_factors
from tests import catalogue_rig
from tests.panel_pixels import from_pictures, random_frames, upright
from tests.unit.probing.test_pixel_matrix import log_of

GRID = (3, 4)
LUT = (0.0, 0.3, 1.0)


def test_the_realised_matrix_has_the_light_of_the_levels_in_it() -> None:
    rng = np.random.default_rng(1)
    light, mask = rng.random((5, 12)), rng.random((5, 12))
    found = catalogue_rig.show(
        light,
        mask,
        GRID,
        guards=False,
        projector=PanelOptics(curve=make_power_curve(2.2)),
        mask=PanelOptics(curve=make_table_curve(LUT)),
    )
    given = (np.rint(255.0 * light) / 255.0) ** 2.2
    at = np.rint(255.0 * mask) / 255.0
    seen = np.where(at < 0.5, 0.6 * at, 0.3 + 1.4 * (at - 0.5))
    wanted = seen.T @ given * catalogue_rig.REFRESH_S
    np.testing.assert_allclose(found.dense(), wanted, rtol=1e-6)


@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_pixels_that_were_seen_have_the_same_light(window: str) -> None:
    frames = random_frames(GRID, window, 9, grey=True, seed=3)
    projector = PanelConfig(size_px=(32, 24), gamma=2.2)
    mask = PanelConfig(size_px=(48, 36), lut=LUT)
    views = upright((32, 24), mask=False), upright((48, 36), mask=True)
    shown = from_pictures(*([draw(frames, view, row) for row in range(9)] for view in views))
    log, close_ns = log_of(9), 10**9
    by_pixel = collect_factors(
        compute_pixel_factors(shown, log, projector, mask, grid=GRID, open_ns=0, close_ns=close_ns)
    )
    by_cell = collect_factors(
        compute_bench_factors(frames, log, projector, mask, open_ns=0, close_ns=close_ns)
    )
    np.testing.assert_allclose(by_pixel.dense(), by_cell.dense(), rtol=1e-9)
    np.testing.assert_allclose(by_pixel.coaxial, by_cell.coaxial, rtol=1e-9)


def test_a_panel_of_which_nothing_is_said_gives_what_it_is_sent() -> None:
    """As ever: old runs are decoded by these very numbers."""
    light = np.array([[0.1, 0.5, 1.0, 0.001]])
    frames = build_frames(
        (light.astype(np.float32), np.ones((1, 4), np.float32)),
        (1, 4),
        window="whole",
        schedule="none",
        passes=1,
    )
    panel = PanelConfig(size_px=(16, 4))
    found = collect_factors(
        compute_bench_factors(frames, log_of(1), panel, panel, open_ns=0, close_ns=10**9)
    )
    np.testing.assert_allclose(found.right[0], light[0].astype(np.float32), rtol=1e-12)
