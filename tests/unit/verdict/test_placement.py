"""What photos say of where the panels are, on light made up for it; and light that says nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.panels.placing import Placing, make_placed_map
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap
from pdcd.verdict.evidence import PIXELS_PER_CELL, PixelSample
from pdcd.verdict.placement import (
    LightSample,
    fit_fingerprints,
    fit_stack_fingerprints,
    list_panel_symmetries,
    map_direct_shares,
)

GRID = (12, 12)
CELLS = GRID[0] * GRID[1]
Floats = NDArray[np.float64]


def codes(rows: int, seed: int = 0) -> Factors:
    """Coins for the projector, their opposites for the mask."""
    lit = np.random.default_rng(seed).integers(0, 2, (rows, CELLS)).astype(float)
    return Factors(1.0 - lit, lit, np.zeros(CELLS), (1.0 - lit).sum(axis=0))


def white() -> Factors:
    one = np.ones((1, CELLS))
    return Factors(one, one, np.ones(CELLS), np.ones(CELLS))


def known_shares(samples: list[LightSample], grid: tuple[int, int]) -> Floats:
    """Shares of direct light of the cells of which photos tell it."""
    shares = map_direct_shares(samples, grid)
    return shares[np.isfinite(shares)]


def seen(realised: Factors, way: NDArray[np.int64], direct: float, other: float) -> Floats:
    """Light with a projector whose picture lies in that way: direct, and evenly from everywhere."""
    own = np.einsum("rn,rn->n", realised.left, realised.right[:, way])
    rest = realised.right.mean(axis=1) @ realised.left
    light: Floats = direct * own + other * rest
    return light


@pytest.mark.parametrize("name", list(list_panel_symmetries(GRID)))
@pytest.mark.parametrize("reference", [None, np.ones(CELLS)])
def test_every_symmetry_is_named(name: str, reference: Floats | None) -> None:
    realised = codes(16)
    light = seen(realised, list_panel_symmetries(GRID)[name], 0.7, 0.3)
    fits = list(fit_fingerprints(LightSample(light, realised, reference), GRID))
    best = max(fits, key=lambda fit: abs(fit.over_chance))
    assert best.name == name and best.share > 0.5 and best.over_chance > 6.0


def test_a_grid_that_is_not_square_has_no_quarter_turns() -> None:
    assert set(list_panel_symmetries((3, 4))) == {
        "mirrored left to right", "mirrored top to bottom", "turned by 180 degrees",
    }  # fmt: skip


def test_single_codes_tell_from_photo_to_photo() -> None:
    parts = [codes(1, seed) for seed in range(20)]
    opened = [Factors(np.ones((1, CELLS)), p.right, p.right[0], np.ones(CELLS)) for p in parts]
    mirrored = list_panel_symmetries(GRID)["mirrored left to right"]
    for way, best in ((np.arange(CELLS), "as believed"), (mirrored, "mirrored left to right")):
        samples = [LightSample(seen(one, way, 0.7, 0.3), one) for one in opened]
        fits = list(fit_stack_fingerprints(samples, GRID))
        top = max(fits, key=lambda fit: fit.over_chance)
        assert top.name == best and top.share > 0.5 and top.over_chance > 6.0
        assert all(abs(fit.share) < 0.3 for fit in fits if fit.name != best)


def test_share_of_direct_light() -> None:
    cells = np.arange(CELLS)
    coded, lit = codes(256), white()
    whole = LightSample(0.7 + 0.3 * np.ones(CELLS), lit)
    sound = known_shares([whole, LightSample(seen(coded, cells, 0.0, 0.3), coded)], GRID)
    assert np.median(sound) == pytest.approx(0.7, abs=0.05)
    elsewhere = seen(coded, np.roll(cells, 1), 0.7, 0.3)
    lost = known_shares([whole, LightSample(elsewhere, coded)], GRID)
    assert abs(float(np.median(lost))) < 0.05


@pytest.mark.parametrize("light", [0.0, -1.0, np.nan])
def test_light_that_tells_nothing(light: float) -> None:
    nothing = np.full(CELLS, light)
    one = LightSample(nothing, codes(8))
    assert known_shares([one, LightSample(nothing, white())], GRID).size == 0
    assert known_shares([one, one], GRID).size == 0
    assert known_shares([one], GRID).size == 0
    assert list(fit_fingerprints(one, GRID)) == []
    assert list(fit_stack_fingerprints([one, one], GRID)) == []
    assert list(fit_stack_fingerprints([], GRID)) == []


def test_few_cells_say_nothing() -> None:
    one = np.ones((1, 1))
    alone = Factors(one, one, np.ones(1), np.ones(1))
    sample = LightSample(np.ones(1), alone)
    assert list(fit_fingerprints(sample, (1, 1))) == []
    assert known_shares([sample, sample], (1, 1)).size == 0
    assert list(fit_stack_fingerprints([sample, sample], (1, 1))) == []


@pytest.mark.parametrize("scale", [1.0, 2.0, 3.0])
def test_cells_are_looked_at_however_small_the_field_is_in_the_frame(scale: float) -> None:
    width, height = 1068, 712
    place = make_placed_map(Placing(scale=scale), (width, height), (1024, 768), "camera")
    thin = PixelSample.of(CellMap(grid=(48, 64), frame=(height, width), map=place))
    count = np.bincount(thin.cell[thin.cell >= 0], minlength=thin.cells)
    assert count.min() >= 1 and count.mean() >= PIXELS_PER_CELL
