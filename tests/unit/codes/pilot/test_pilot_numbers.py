"""What a pilot makes and finds stays the same: codes of seeds, and paths of a small scene."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
import scipy.sparse
from numpy.typing import NDArray

from pdcd.codes.pilot.codes import (
    SCOUTS,
    make_pilot_codes,
)
from pdcd.codes.pilot.links import (
    estimate_links,
    estimate_sharpness,
    match_links,
    predict_pilot_errors,
)
from pdcd.codes.pilot.matching import find_partners, weigh_partners
from pdcd.codes.pilot.scene_light import (
    check_photos,
)
from pdcd.errors import ConfigError, RequestError

GRID = (6, 9)
N = 54


@pytest.mark.parametrize(
    ("count", "digest"),
    [(4, "45dd7539e3a0ccf2"), (8, "099cf823c535260f"), (12, "91413aee2dc00776"),
     (16, "6d5e3226be982523"), (32, "f1b64aa80ec038ff"), (64, "fde7a7bceb95eae4")],
)  # fmt: skip
def test_seeds_of_pilots_keep_their_codes(count: int, digest: str) -> None:
    """Photos of a pilot that was stored are read by codes that are made again."""
    codes = make_pilot_codes((7, 9), count, seed=3)
    assert codes.shape == (count, 63) and codes.dtype == np.bool_
    assert hashlib.sha256(np.packbits(codes).tobytes()).hexdigest().startswith(digest)


def test_cells_of_a_tile_have_different_codes_as_far_as_these_go() -> None:
    """Twelve photos: eight after the scouts, lit three to five times; sixteen cells a tile."""
    codes = make_pilot_codes((8, 8), 12, seed=1)[SCOUTS:]
    assert set(codes.sum(axis=0).tolist()) <= {3, 4, 5}
    of_tiles = codes.reshape(8, 2, 4, 2, 4).swapaxes(2, 3).reshape(8, 4, 16)
    for tile in range(4):
        assert len(np.unique(of_tiles[:, tile], axis=1).T) == 16
    # Four photos have fourteen such codes: each is used once before any comes again.
    few = make_pilot_codes((4, 4), 8, seed=2)[SCOUTS:]
    assert set(few.sum(axis=0).tolist()) == {1, 2, 3}
    _, times = np.unique(few, axis=1, return_counts=True)
    assert sorted(times.tolist()) == [1] * 12 + [2] * 2


@pytest.mark.parametrize("count", [0, 6, 20, 28, 36, 52])
def test_pilots_of_other_numbers_are_refused(count: int) -> None:
    with pytest.raises(RequestError, match=f"pilot of {count} codes"):
        make_pilot_codes((2, 3), count, seed=0)


def test_the_finest_grid_of_a_map() -> None:
    assert make_pilot_codes((1, 4097), SCOUTS, seed=0).shape == (4, 4097)
    assert make_pilot_codes((1, 4096), 8, seed=0).shape == (8, 4096)
    with pytest.raises(RequestError, match="at most 4096 cells"):
        make_pilot_codes((1, 4097), 8, seed=0)


def transport() -> NDArray[np.float64]:
    """Three columns on the left mirror those on the right, stronger one way than the other."""
    found = np.diag(np.random.default_rng(1).uniform(0.5, 1.0, N)) + 0.3 / N
    for y in range(1, 5):
        for x in range(3):
            left, right = 9 * y + x, 9 * y + 8 - x
            found[left, right] += 0.3
            found[right, left] += 0.2
    return found


def photos_of(count: int) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    codes = make_pilot_codes(GRID, count, seed=3)
    noise = np.random.default_rng(2).normal(0.0, 0.01, (count, N))
    return codes, codes @ transport().T + noise


@pytest.mark.parametrize(
    ("count", "of_row", "moment"),
    [
        (8, [0.293254, 0.300391, 0.309937, 0.027539, 0.010630, 0.028010, 0.186104, 0.188059,
             0.196750], 5351.047914750694),
        (12, [0.290910, 0.295026, 0.286639, 0.034144, 0.016446, 0.025162, 0.211751, 0.215536,
              0.218665], 5463.903571767995),
    ],
)  # fmt: skip
def test_a_small_mirror_is_mapped_as_it_was(count: int, of_row: list[float], moment: float) -> None:
    """0.3 into its left part, 0.2 into its right one; numbers as runs were decoded with them."""
    codes, photos = photos_of(count)
    noise = np.full(N, 0.01)
    paths = weigh_partners(find_partners(codes, photos, GRID, noise), codes, photos, GRID, noise)
    row = np.asarray(paths.sum(axis=1))[9:18]
    np.testing.assert_allclose(row, of_row, rtol=2e-4, atol=1e-5)
    assert row[:3] == pytest.approx(0.3, rel=0.1) and row[-3:] == pytest.approx(0.2, rel=0.1)
    at = np.arange(N, dtype=np.float64)
    assert float(at @ paths @ at) == pytest.approx(moment, rel=2e-4)


def test_channels_that_are_alike_are_weighed_once() -> None:
    codes, photos = photos_of(8)
    same = np.repeat(photos[..., None], 2, axis=2)
    sigma = np.full(same.shape, 0.01)
    found = match_links(codes, same, GRID, sigma=sigma)
    assert len(found) == 3 and all(one is found[0] for one in found)
    one = match_links(codes, photos[..., None], GRID, sigma=sigma[..., :1])
    assert len(one) == 2 and one[0] is one[1]
    other = same.copy()
    other[..., 1] *= 0.5
    links, first, second = match_links(codes, other, GRID, sigma=sigma)
    np.testing.assert_allclose(links.toarray(), 0.5 * (first + second).toarray())
    assert second.sum() == pytest.approx(0.5 * first.sum(), rel=0.1)


def test_rows_of_many_paths_and_weak_ones_beside_strong_ones_are_found() -> None:
    """Row by row, a few entries a round. Those beside a path need not stand out as much; a row
    without light has none."""
    true = np.zeros((N, N))
    true[40, [3, 11, 30, 45, 50]] = 0.3, 0.35, 0.4, 0.45, 0.5
    true[7, [33, 34, 24]] = 0.3, 0.06, 0.06
    true[12, [50, 2]] = 0.002, 0.003  # a cell of little light has a scale of its own
    light = np.diag(np.full(N, 0.8))
    light[12] *= 0.01
    light[25] = 0.0
    codes = make_pilot_codes(GRID, 128, seed=3)
    found = estimate_links(codes, codes @ (light + true).T, GRID).toarray()
    np.testing.assert_allclose(found, true, atol=2e-3)
    np.testing.assert_allclose(found[12], true[12], atol=2e-5)
    assert not found[25].any()


def test_arrays_of_a_pilot_must_fit_each_other() -> None:
    codes, photos = photos_of(32)
    paths = scipy.sparse.csr_array((N, N))
    for bad_codes, bad_photos in (
        (codes[:31], photos),
        (codes, photos[:, 1:]),
        (~codes[0], photos),
    ):
        for use in (
            lambda c, p: estimate_links(c, p, GRID),
            lambda c, p: predict_pilot_errors(c, p, paths, 99),
            lambda c, p: check_photos(c, p, N),
        ):
            with pytest.raises(ConfigError):
                use(bad_codes, bad_photos)
    with pytest.raises(ConfigError, match="leaves nothing of 32 codes"):
        predict_pilot_errors(codes, photos, paths, 32)
    with pytest.raises(ConfigError, match="do not fit 53 cells"):
        check_photos(codes, photos, 53)
    odd = codes.copy()
    odd[0, 7] = ~odd[0, 7]
    for use_one in (
        lambda c: estimate_links(c, photos, GRID),
        lambda c: estimate_sharpness(c, photos),
    ):
        with pytest.raises(ConfigError, match="half of the pilot codes"):
            use_one(odd)
