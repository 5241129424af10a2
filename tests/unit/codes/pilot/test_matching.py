"""The map of a mirror from a few photos, on scenes whose map is known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.pilot import matching
from pdcd.codes.pilot.codes import make_pilot_codes
from pdcd.codes.pilot.links import compute_path_correction
from pdcd.codes.pilot.matching import (
    BREAK_COST,
    FAR_COST,
    find_partners,
    weigh_partners,
)
from pdcd.recipes.alternatives import FittedWeights

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
GRID = (18, 26)
CELLS = GRID[0] * GRID[1]
STRENGTH = 0.3


def mirror(slope: float, *, glow: float = 0.02, shuffled: bool = False) -> Floats:
    """Transport (N, N): the left third mirrors the rest, flipped and squeezed, there and back."""
    rng = np.random.default_rng(5)
    transport = np.diag(rng.uniform(0.5, 1.0, CELLS)) + glow / CELLS
    image = np.zeros((CELLS, CELLS))
    for y in range(2, 16):
        for x in range(1, 8):
            there = 22.0 - slope * x
            low = int(there)
            part = there - low
            image[y * GRID[1] + x, y * GRID[1] + low] += STRENGTH * (1.0 - part)
            image[y * GRID[1] + x, y * GRID[1] + low + 1] += STRENGTH * part
    if shuffled:
        image = image[:, rng.permutation(CELLS)]
    return transport + image + image.T


def photos_of(transport: Floats, codes: Bools, sigma: float = 0.0) -> Floats:
    noise = np.random.default_rng(1).normal(0.0, 1.0, (len(codes), CELLS))
    photos: Floats = codes @ transport.T + sigma * noise
    return photos


def indirect_errors(transport: Floats, codes: Bools, photos: Floats) -> tuple[float, float]:
    """RMS errors of the indirect image masked in software, without and with the paths found."""
    truth = transport.sum(axis=1) - np.diag(transport)
    noise = np.zeros(CELLS)
    partners = find_partners(codes, photos, GRID, noise)
    paths = weigh_partners(partners, codes, photos, GRID, noise)
    weights = FittedWeights(0.0, 1.0)(codes)
    image = np.sum(weights * photos, axis=0)
    better = image + compute_path_correction(weights, codes.astype(np.float64), 1.0, paths)
    scale = np.sqrt(np.mean(truth**2))
    return tuple(float(np.sqrt(np.mean((i - truth) ** 2)) / scale) for i in (image, better))  # type: ignore[return-value]


@pytest.mark.long
@pytest.mark.parametrize(
    ("slope", "count"), [(1.0, 8), (1.25, 8), (0.8, 8), (0.8, 12), (1.25, 12), (1.25, 16)]
)
def test_the_map_of_a_mirror_is_found(slope: float, count: int) -> None:
    transport = mirror(slope)
    codes = make_pilot_codes(GRID, count, seed=1)
    plain, mapped = indirect_errors(transport, codes, photos_of(transport, codes))
    assert mapped < {8: 0.6, 12: 0.3, 16: 0.25}[count] * plain


def test_paths_have_the_strength_of_the_mirror() -> None:
    transport = mirror(1.0)
    codes = make_pilot_codes(GRID, 16, seed=2)
    photos = photos_of(transport, codes)
    noise = np.zeros(CELLS)
    sparse = weigh_partners(find_partners(codes, photos, GRID, noise), codes, photos, GRID, noise)
    paths = sparse.toarray()
    assert sparse.nnz == np.count_nonzero(paths)  # what is no path takes no room
    true = np.where(transport > 0.1, transport, 0.0)
    np.fill_diagonal(true, 0.0)
    assert np.all(paths >= 0.0) and not np.diag(paths).any()
    assert np.sum((paths - true) ** 2) < 0.1 * np.sum(true**2)
    assert np.median(paths[true > 0.0]) == pytest.approx(STRENGTH, rel=0.05)


def test_a_map_that_is_not_smooth_is_not_made_up() -> None:
    """The same light from anywhere: no map, and little harm."""
    transport = mirror(1.0, shuffled=True)
    codes = make_pilot_codes(GRID, 8, seed=3)
    plain, mapped = indirect_errors(transport, codes, photos_of(transport, codes))
    assert mapped < 1.2 * plain


@pytest.mark.long
def test_noise_that_is_told_of_does_not_become_paths() -> None:
    """Nothing but noise between the photos: half of it, not all, may look like a partner's."""
    sigma = 0.05
    transport = np.diag(np.full(CELLS, 0.8)) + 0.1 / CELLS
    codes = make_pilot_codes(GRID, 8, seed=4)
    photos = photos_of(transport, codes, sigma)
    sums = []
    for told in (0.0, sigma):
        noise = np.full(CELLS, told)
        partners = find_partners(codes, photos, GRID, noise)
        sums.append(float(weigh_partners(partners, codes, photos, GRID, noise).sum()))
    assert sums[1] < 0.7 * sums[0]


@pytest.mark.long
@pytest.mark.parametrize("scale", [1e-9, 1e6])
def test_units_do_not_matter(scale: float) -> None:
    transport = mirror(1.25)
    codes = make_pilot_codes(GRID, 8, seed=7)
    photos = photos_of(transport, codes)
    noise = np.zeros(CELLS)
    found = [
        weigh_partners(
            find_partners(codes, s * photos, GRID, noise), codes, s * photos, GRID, noise
        )
        / s
        for s in (1.0, scale)
    ]
    np.testing.assert_allclose(found[1].sum(axis=1), found[0].sum(axis=1), rtol=0.02, atol=1e-3)


@pytest.mark.parametrize("photos", [np.zeros((8, 12)), np.ones((8, 12))])
def test_black_and_even_photos_have_no_paths(photos: Floats) -> None:
    codes = make_pilot_codes((3, 4), 8, seed=0)
    noise = np.zeros(12)
    paths = weigh_partners(
        find_partners(codes, photos, (3, 4), noise), codes, photos, (3, 4), noise
    )
    assert np.all(np.isfinite(paths.data)) and paths.sum() < 1e-6 * max(photos.sum(), 1e-30)


@pytest.mark.parametrize("grid", [(1, 1), (1, 9), (7, 1), (13, 17)])
def test_any_grid_will_do(grid: tuple[int, int]) -> None:
    codes = make_pilot_codes(grid, 8, seed=0)
    cells = grid[0] * grid[1]
    photos = np.where(codes, 0.8, 0.1)
    noise = np.zeros(cells)
    paths = weigh_partners(find_partners(codes, photos, grid, noise), codes, photos, grid, noise)
    assert paths.shape == (cells, cells) and np.all(np.isfinite(paths.data))


def test_messages_along_a_row_are_those_of_all_ways_to_choose() -> None:
    """On a chain of cells messages are exact: for each cell and partner the best of all choices of
    the others, where partners of next cells may lie one cell apart for nothing, two for
    `FAR_COST`, and anywhere for `BREAK_COST`."""
    own = np.random.default_rng(4).normal(0.0, 3.0, (1, 3, 1, 9)).astype(np.float32)
    heard = matching._messages(own)
    best = np.full((3, 9), -np.inf)
    for choice in itertools.product(range(9), repeat=3):
        apart = np.abs(np.diff(choice))
        cost = np.select([apart <= 1, apart <= 2], [0.0, FAR_COST], BREAK_COST).sum()
        score = sum(own[0, cell, 0, at] for cell, at in enumerate(choice)) - cost
        for cell, at in enumerate(choice):
            best[cell, at] = max(best[cell, at], score)
    got = (own + heard)[0, :, 0]
    # Each step goes half of the way: what is left after so many is small, not nothing.
    wrong = (got - got.max(axis=1, keepdims=True)) - (best - best.max(axis=1, keepdims=True))
    assert np.abs(wrong).max() < 0.2 * np.ptp(best)
    assert np.array_equal(got.argmax(axis=1), best.argmax(axis=1))


@pytest.mark.parametrize("grid", [(6, 7), (1, 9), (5, 1)])
def test_a_message_is_the_best_partner_less_what_its_distance_costs(grid: tuple[int, int]) -> None:
    """Relative to the best of all: one cell apart for nothing, two for a little, and anywhere."""
    rng = np.random.default_rng(1)
    belief = rng.normal(0.0, 6.0, (2, *grid)).astype(np.float32)
    row, col = np.divmod(np.arange(belief[0].size), grid[1])
    apart = np.maximum(np.abs(row[:, None] - row), np.abs(col[:, None] - col))
    cost = np.select([apart <= 1, apart <= 2], [0.0, FAR_COST], BREAK_COST)
    wanted = (belief.reshape(2, 1, -1) - cost).max(axis=2) - belief.reshape(2, -1).max(axis=1)[
        :, None
    ]
    found = matching._told(belief)
    np.testing.assert_allclose(found.reshape(2, -1), wanted, atol=1e-5)
    assert found.min() >= -BREAK_COST and found.max() == 0.0


def test_the_likeliest_light_of_a_partner_weighs_its_photos_against_what_is_usual() -> None:
    """By trying all strengths: misfit to the photos, and distance from the usual in its spread."""
    rng = np.random.default_rng(3)
    seen, photos, usual, spread = rng.random(8), rng.random(8), 0.7, 0.04
    light, log = matching._log_likelihood(
        seen @ photos, seen @ seen, photos @ photos, usual, spread, len(photos)
    )
    tried = np.linspace(0.0, 3.0, 30_001)
    misfit = np.sum((photos - tried[:, None] * seen) ** 2, axis=1) + (tried - usual) ** 2 / spread
    assert light == pytest.approx(tried[misfit.argmin()], abs=2e-4)
    degrees = len(photos) - 2
    wanted = -0.5 * degrees * np.log1p(misfit.min() / degrees)
    assert log == pytest.approx(wanted - 0.5 * np.log1p(seen @ seen * spread), abs=1e-6)


@pytest.mark.parametrize("scattered", [0.1, 1.5])
def test_the_cells_around_foretell_a_partner_by_their_plane(scattered: float) -> None:
    """Cell by cell, by sums over its neighbours written out here: the plane of least squares
    through their partners, how far these scatter about it, and what that says of each candidate."""
    rng = np.random.default_rng(8)
    grid, candidates = (5, 6), 3
    cells = grid[0] * grid[1]
    at = np.array(np.divmod(np.arange(cells), grid[1]), dtype=float)
    plane = np.array([[3.0, 0.4, -0.7], [9.0, -0.2, 0.6]])
    middle = plane[:, :1] + plane[:, 1:] @ at
    places = middle[:, None, :, None] + rng.normal(0.0, scattered, (2, 2, cells, candidates))
    weight = rng.random((2, cells, candidates))
    weight /= weight.sum(axis=(0, 2), keepdims=True)
    sure = rng.random(cells)
    found = matching._map_prior(places, weight, sure, grid)
    own = (weight * places).sum(axis=(1, 3))
    for cell in range(cells):
        step = (at - at[:, cell, None]).T
        near = (np.abs(step).max(axis=1) <= matching.MATCHING_REACH) & (np.arange(cells) != cell)
        says = near * sure * np.exp(-(step**2).sum(axis=1) / matching.MATCHING_REACH)
        # Three rows that hold the plane back a little, so that there always is one.
        rows = np.vstack([np.column_stack([np.ones(cells), step]), np.eye(3)])
        by = np.sqrt(np.append(says, [1e-6, 0.3, 0.3]))
        apart, scatter = np.zeros((2, candidates)), 0.0
        for axis in range(2):
            aim = np.append(own[axis], np.zeros(3))
            fit, *_ = np.linalg.lstsq(by[:, None] * rows, by * aim, rcond=None)
            apart += (places[axis, :, cell] - fit[0]) ** 2
            scatter += float(np.sum((by * (aim - rows @ fit)) ** 2))
        variance = scatter / (2.0 * says.sum()) + matching.LEAST_SPREAD**2
        trust = says.sum() / (says.sum() + 1.0)
        wanted = -trust * np.minimum(0.5 * apart / variance, BREAK_COST)
        np.testing.assert_allclose(found[:, cell], wanted, rtol=1e-6, atol=1e-9)
    assert np.mean(found > -0.9 * BREAK_COST) > 0.2
