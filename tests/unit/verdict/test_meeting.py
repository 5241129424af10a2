"""Direct light that is there against what photos of codes show of it, on light made up for it."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.placing import Placing, make_placed_map
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap
from pdcd.verdict.meeting import compare_with_blocks, compare_with_single_codes, measure_own_part
from pdcd.verdict.placement import LightSample

CELLS = 144


def single_codes(direct: float) -> list[LightSample]:
    """Photos of a code each through an open mask, of cells of unlike brightness; each is lit in
    half of them."""
    rng = np.random.default_rng(1)
    albedo = rng.uniform(0.5, 1.0, CELLS)
    made = []
    half = rng.integers(0, 2, (8, CELLS)).astype(float)
    for lit in (*half, *(1.0 - half)):
        light = albedo * (direct * lit + (1.0 - direct) * lit.mean())
        realised = Factors(np.ones((1, CELLS)), lit[None], lit, np.ones(CELLS))
        made.append(LightSample(light, realised))
    return made


@pytest.mark.parametrize("kept", [1.0, 0.8, 0.0, -0.3])
def test_single_codes_tell_what_is_lost(kept: float) -> None:
    light = compare_with_single_codes(np.full(CELLS, 0.7 * kept), single_codes(0.7), 1.0)
    assert light is not None
    assert light.shown / light.there == pytest.approx(kept, abs=max(0.05, light.unsure))
    assert light.unsure < 0.06


def test_pixels_that_see_two_cells_dim_the_code_and_not_the_light() -> None:
    light = compare_with_single_codes(np.full(CELLS, 0.7), single_codes(0.7 * 0.9), 0.9)
    assert light is not None and light.there == pytest.approx(0.7, abs=0.04)


def test_nothing_is_told_of_light_that_is_not_there() -> None:
    coded, unknown = np.full(CELLS, 0.05), np.full(CELLS, np.nan)
    assert compare_with_single_codes(coded, single_codes(0.02), 1.0) is None
    assert compare_with_single_codes(coded, [], 1.0) is None
    assert compare_with_single_codes(unknown, single_codes(0.7), 1.0) is None
    assert compare_with_blocks(coded, 0.0) is None
    assert compare_with_blocks(unknown, 0.7) is None


def test_what_quads_see_of_their_own_cell() -> None:
    """Of squares: with one each, all; of 2.5 quads to a cell's side, every fifth lies across a
    border and half of it beside."""

    def of(width: int, height: int) -> float:
        place = make_placed_map(Placing(), (width, height), (1024, 768), "camera")
        return measure_own_part(CellMap(grid=(6, 8), frame=(height, width), map=place))

    assert of(8, 6) == pytest.approx(1.0)
    assert of(32, 24) == pytest.approx(1.0)
    assert of(20, 15) == pytest.approx(0.9**2, abs=0.02)
