"""What photos say of where the panels are, on light and codes that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.panels.placing import Placing, make_placed_map
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap
from pdcd.verdict import placement
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


def keeping(cells: int, direct: float, other: float) -> Factors:
    """A photo that keeps so much of direct light, and so much of that of every other cell."""
    one = np.ones((1, cells))
    total = other * (cells - 1) + direct
    return Factors(one, one * total / cells, np.full(cells, direct), np.ones(cells))


def two(
    cells: int, direct: float = 0.6, other: float = 0.4, kept: float = 0.0
) -> list[LightSample]:
    """All light, and a photo that keeps `kept` of direct and half of other light."""
    ones = np.ones(cells)
    return [
        LightSample((direct + other) * ones, keeping(cells, 1.0, 1.0)),
        LightSample((kept * direct + 0.5 * other) * ones, keeping(cells, kept, 0.5)),
    ]


def by_codes(realised: Factors, way: NDArray[np.int64]) -> Floats:
    """Direct light alone, with a projector that lies in that way."""
    light: Floats = np.einsum("rn,rn->n", realised.left, realised.right[:, way])
    return light


def test_a_grid_that_is_not_square_has_no_quarter_turns() -> None:
    assert set(list_panel_symmetries((3, 4))) == {
        "mirrored left to right", "mirrored top to bottom", "turned by 180 degrees",
    }  # fmt: skip


def test_a_panel_a_cell_beside_its_place_seems_to_have_no_direct_light() -> None:
    coded = codes(256)
    whole = LightSample(np.ones(CELLS), white())
    elsewhere = by_codes(coded, np.roll(np.arange(CELLS), 1))
    light = 0.7 * elsewhere + 0.3 * coded.right.mean(axis=1) @ coded.left
    lost = known_shares([whole, LightSample(light, coded)], GRID)
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


def test_shares_of_direct_light_are_exact_where_the_light_is() -> None:
    np.testing.assert_allclose(known_shares(two(64), (8, 8)), np.full(64, 0.6))
    np.testing.assert_allclose(known_shares(two(64, 0.1, 0.9, 0.05), (8, 8)), np.full(64, 0.1))
    assert known_shares(two(63), (7, 9)).size == 0
    assert known_shares(2 * two(64)[:1], (8, 8)).size == 0  # both keep the same


def test_cells_that_no_pixel_sees_are_left_out() -> None:
    samples = two(72)
    samples[1].light[:8] = np.nan
    np.testing.assert_allclose(known_shares(samples, (9, 8)), np.full(64, 0.6))
    samples[0].light[8] = np.nan
    assert known_shares(samples, (9, 8)).size == 0


def test_dark_cells_tell_nothing() -> None:
    """Columns whose surroundings have less than a tenth of the light of the bright ones."""
    grid, cells = (16, 16), 256
    for level, columns in ((0.05, 10), (0.11, 16)):
        samples = two(cells)
        dim = np.where(np.arange(cells) % 16 < 8, level, 1.0)
        dimmed = [LightSample(s.light * dim, s.realised) for s in samples]
        shares = known_shares(dimmed, grid)
        assert shares.size == columns * 16
        np.testing.assert_allclose(shares, 0.6)


@pytest.mark.parametrize("name", list(list_panel_symmetries(GRID)))
def test_light_that_all_follows_a_fingerprint_fits_it_wholly(name: str) -> None:
    """Then it exceeds chance by the root of the number of cells."""
    realised = codes(256)
    light = by_codes(realised, list_panel_symmetries(GRID)[name])
    fits = list(fit_fingerprints(LightSample(light, realised, np.ones(CELLS)), GRID))
    assert len(fits) == 2 * 7
    best = max(fits, key=lambda fit: fit.over_chance)
    assert best.name == name and best.over_chance == pytest.approx(12.0, rel=0.02)
    rows = realised.right.sum(axis=1) @ realised.left
    assert best.share == pytest.approx(rows.mean() / (CELLS - 1) / light.mean(), rel=0.02)
    inverse = 2.0 * light.mean() - light
    worst = min(
        fit_fingerprints(LightSample(inverse, realised, np.ones(CELLS)), GRID),
        key=lambda f: f.over_chance,
    )
    assert worst.share == pytest.approx(-best.share) and worst.name == name
    alone = fit_fingerprints(LightSample(light, realised), GRID)  # without a white photo
    assert max(alone, key=lambda fit: fit.over_chance).name == name


def test_of_very_many_codes_cells_around_the_centre_are_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    realised = codes(256)
    light = by_codes(realised, list_panel_symmetries(GRID)["turned by 180 degrees"])
    sample = LightSample(light, realised, np.ones(CELLS))
    for side, over in ((9, 9.0), (8, 8.0)):
        monkeypatch.setattr(placement, "PRODUCTS", 256 * side**2 + 1)
        best = max(fit_fingerprints(sample, GRID), key=lambda fit: fit.over_chance)
        assert best.name == "turned by 180 degrees"
        assert best.over_chance == pytest.approx(over, rel=0.07)
    monkeypatch.setattr(placement, "PRODUCTS", 256 * 7**2 + 1)
    assert list(fit_fingerprints(sample, GRID)) == []


def test_cells_that_are_dark_in_the_reference_tell_nothing() -> None:
    realised = codes(256)
    light = by_codes(realised, list_panel_symmetries(GRID)["mirrored left to right"])
    reference = np.ones(CELLS)
    reference[:44] = 0.0
    light[:44] = 1e6
    sample = LightSample(light, realised, reference)
    assert all(abs(fit.over_chance) <= 10.01 for fit in fit_fingerprints(sample, GRID))
    reference[:81] = np.nan
    assert list(fit_fingerprints(sample, GRID)) == []


def opened(count: int) -> list[Factors]:
    """Photos of one code each through an open mask."""
    lit = np.random.default_rng(5).integers(0, 2, (count, 1, CELLS)).astype(float)
    one = np.ones((1, CELLS))
    return [Factors(one, code, code[0], np.ones(CELLS)) for code in lit]


@pytest.mark.parametrize("name", ["as believed", *list_panel_symmetries(GRID)])
def test_a_stack_of_codes_fits_its_own_place_wholly(name: str) -> None:
    way = {"as believed": np.arange(CELLS), **list_panel_symmetries(GRID)}[name]
    samples = [LightSample(one.right[0, way], one) for one in opened(40)]
    fits = list(fit_stack_fingerprints(samples, GRID))
    assert [fit.name for fit in fits] == ["as believed", *list_panel_symmetries(GRID)]
    (fit,) = (fit for fit in fits if fit.name == name)
    assert fit.share == pytest.approx(1.0, abs=0.03)
    assert fit.over_chance == pytest.approx(np.sqrt(40 * CELLS), rel=0.02)


def test_a_stack_leaves_out_cells_that_are_dark_or_unseen() -> None:
    codes_of = opened(40)
    samples = [LightSample(one.right[0].copy(), one) for one in codes_of]
    for sample in samples:
        sample.light[:40] = np.nan
        sample.light[40:80] *= 0.05
    (own, *_) = fit_stack_fingerprints(samples, GRID)
    assert own.over_chance == pytest.approx(np.sqrt(40 * 64), rel=1e-6)
    samples[3].light[80] = np.nan
    assert list(fit_stack_fingerprints(samples, GRID)) == []
    assert list(fit_stack_fingerprints(samples[:1], GRID)) == []
