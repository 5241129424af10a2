"""What the parts of a photo differ by tells how much smooth light it holds, against dense sums."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.codes.make import make_codes
from pdcd.pictures.shares import FROM, TO
from pdcd.pictures.smooth import (
    CodedImage,
    compute_smooth_correction,
    estimate_smooth_shares,
)

Floats = NDArray[np.float64]

GRID = (12, 16)
N = GRID[0] * GRID[1]
PARTS = 4
ROW, COL = np.divmod(np.arange(N), GRID[1])
SQUARED = (ROW[:, None] - ROW) ** 2.0 + (COL[:, None] - COL) ** 2.0
NEAR = np.maximum(abs(ROW[:, None] - ROW), abs(COL[:, None] - COL))


def transport(falling: Floats, texture: float, radius: int) -> Floats:
    """``x_n k(d) x_m`` of a surface that is textured from cell to cell, all from beyond a radius,
    (N, N)."""
    albedo = np.exp(texture * np.random.default_rng(11).standard_normal(N))
    return np.where(radius < NEAR, albedo[:, None] * falling * albedo, 0.0)


def photos(
    light: Floats, wanted: Floats, radius: int, seed: int = 0
) -> tuple[CodedImage, list[CodedImage]]:
    """A photo by random codes and its parts; cells within the radius of a lit one are closed."""
    parts = []
    for part in range(PARTS):
        codes = make_codes("bernoulli", GRID, 24, dual="complement", seed=seed * PARTS + part)
        lit = codes.primal.astype(np.float64)
        if radius:
            lit = (np.random.default_rng([seed, part]).random(lit.shape) < 0.02).astype(np.float64)
        mask = (lit @ (radius >= NEAR) == 0.0).astype(np.float64)
        parts.append((mask, lit))

    def photo(mask: Floats, lit: Floats) -> CodedImage:
        realised = mask.T @ lit
        weight = np.sum(realised * wanted, axis=1) / wanted.sum(axis=1)
        if not radius:
            weight = np.full(N, weight.mean())
        weight = np.where(weight > 0.0, weight, 1.0)
        return CodedImage(mask, lit, weight, np.sum(realised * light, axis=1) / weight)

    masks, lights = (np.concatenate(side) for side in zip(*parts, strict=True))
    return photo(masks, lights), [photo(*part) for part in parts]


def off(image: Floats, truth: Floats) -> float:
    return float(np.sqrt(np.mean((image - truth) ** 2) / np.mean(truth**2)))


@pytest.mark.parametrize("falling", ["even", "near", "between"])
def test_of_a_textured_surface_parts_tell_what_its_image_hides(falling: str) -> None:
    """Texture of a factor of two from cell to cell; light of either form, and of neither."""
    kernels = {
        "even": np.ones((N, N)),
        "near": 1.0 / (1.0 + SQUARED / 4.0),
        "between": np.exp(-np.sqrt(SQUARED) / 4.0),
    }
    light = transport(kernels[falling], 0.7, 0)
    whole, parts = photos(light, 1.0 - np.eye(N), 0)
    truth = light.sum(axis=1)
    shares = estimate_smooth_shares(whole, parts, GRID)
    assert shares is not None and shares.shape == (2,)
    codes = whole.left, whole.right, whole.weight, whole.image, GRID
    alone = off(whole.image + compute_smooth_correction(*codes), truth)
    told = off(whole.image + compute_smooth_correction(*codes, shares=shares), truth)
    assert off(whole.image, truth) > alone
    assert told < 0.5 * alone
    if falling != "between":
        assert abs(shares - ([1.0, 0.0] if falling == "even" else [0.0, 1.0])).max() < 0.15


@pytest.mark.parametrize("reach", [2.0, 5.0])
def test_of_far_light_parts_tell_how_it_falls_off(reach: float) -> None:
    light = transport(1.0 / (1.0 + SQUARED / reach**2) ** 2, 0.7, 1)
    whole, parts = photos(light, (NEAR > 1).astype(np.float64), 1)
    truth = light.sum(axis=1)
    shares = estimate_smooth_shares(whole, parts, GRID, 1)
    assert shares is not None and shares.shape == (3,)
    codes = whole.left, whole.right, whole.weight, whole.image, GRID
    alone = off(whole.image + compute_smooth_correction(*codes, beyond=1), truth)
    told = off(whole.image + compute_smooth_correction(*codes, beyond=1, shares=shares), truth)
    assert told < 0.6 * alone


def test_single_sharp_paths_are_hardly_touched() -> None:
    rng = np.random.default_rng(3)
    light = np.zeros((N, N))
    light[np.arange(N), rng.permutation(N)] = rng.exponential(size=N)
    np.fill_diagonal(light, 0.0)
    whole, parts = photos(light, 1.0 - np.eye(N), 0)
    truth = light.sum(axis=1)
    shares = estimate_smooth_shares(whole, parts, GRID)
    more = compute_smooth_correction(
        whole.left, whole.right, whole.weight, whole.image, GRID, shares=shares
    )
    assert off(whole.image + more, truth) < 1.02 * off(whole.image, truth)


def test_parts_that_differ_by_noise_alone_leave_the_usual_shares() -> None:
    """Codes that count everything alike get nothing wrong: there is nothing to tell."""
    light = np.random.default_rng(4).uniform(0.5, 1.5, N)
    noisy = light + 0.1 * np.random.default_rng(5).standard_normal((PARTS, N))
    parts = [CodedImage(np.eye(N), 1.0 - np.eye(N), 1.0, image) for image in noisy]
    whole = CodedImage(np.eye(N), 1.0 - np.eye(N), 1.0, noisy.mean(axis=0))
    shares = estimate_smooth_shares(whole, parts, GRID)
    assert shares is not None and np.abs(shares - [0.0, 0.1]).max() < 1e-9


def test_shares_stay_within_their_bounds() -> None:
    light = transport(np.exp(-SQUARED / 2.0) - 0.02, 0.0, 0)
    whole, parts = photos(light, 1.0 - np.eye(N), 0)
    shares = estimate_smooth_shares(whole, parts, GRID)
    assert shares is not None and (shares >= FROM).all() and (shares <= TO).all()


def test_a_dark_photo_tells_nothing() -> None:
    dark = CodedImage(np.ones((1, N)), np.ones((1, N)), 1.0, np.zeros(N))
    assert estimate_smooth_shares(dark, [dark, dark], GRID) is None


def test_cells_that_are_not_seen_tell_nothing() -> None:
    """What is put there in want of anything better has neither detail nor parts that differ."""
    light = transport(1.0 / (1.0 + SQUARED / 4.0), 0.1, 0)
    whole, parts = photos(light, 1.0 - np.eye(N), 0)
    seen = COL < GRID[1] / 2

    def blind(one: CodedImage) -> CodedImage:
        image = np.where(seen, one.image, one.image[seen].mean())
        return CodedImage(one.left, one.right, one.weight, image)

    half, halves = blind(whole), [blind(part) for part in parts]
    shares = estimate_smooth_shares(half, halves, GRID, seen=seen)
    assert shares is not None and abs(shares - [0.0, 1.0]).max() < 0.2
    pulled = estimate_smooth_shares(half, halves, GRID)
    assert pulled is not None and pulled[1] < 0.7 * shares[1]
    codes = half.left, half.right, half.weight, half.image, GRID
    told = compute_smooth_correction(*codes, seen=seen)
    assert np.abs(told).max() > 2.0 * np.abs(compute_smooth_correction(*codes)).max()
    truth = light.sum(axis=1)[seen]
    assert off((half.image + told)[seen], truth) < off(half.image[seen], truth)
    # All that are seen is as if nothing was said.
    every = np.ones(N, dtype=np.bool_)
    np.testing.assert_allclose(
        compute_smooth_correction(*codes, seen=every), compute_smooth_correction(*codes), rtol=1e-9
    )


def test_where_no_cell_is_seen_shares_are_the_usual_ones() -> None:
    light = transport(np.ones((N, N)), 0.3, 0)
    whole, parts = photos(light, 1.0 - np.eye(N), 0)
    shares = estimate_smooth_shares(whole, parts, GRID, seen=np.zeros(N, dtype=np.bool_))
    assert shares is not None and abs(shares - [0.0, 0.1]).max() < 1e-9


@pytest.mark.parametrize("grid", [(1, 20), (20, 1)])
def test_a_grid_of_one_row_has_no_detail_but_rounding(grid: tuple[int, int]) -> None:
    """The correction of a photo does not hang on its last bits, which processors round apart."""
    rng = np.random.default_rng(2)
    lit = rng.random((16, 20)) < 0.5
    mask, light = np.where(lit, 0.0, 1.0), np.where(lit, 1.0, 0.02)
    image = rng.uniform(0.5, 1.5, 20)
    other = image * (1.0 + 1e-13 * rng.standard_normal(20))
    one, two = (compute_smooth_correction(mask, light, 4.0, i, grid) for i in (image, other))
    assert np.sqrt(np.mean(one**2)) > 1e-3 and np.allclose(one, two, rtol=0.0, atol=1e-9)
