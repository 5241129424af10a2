"""White balance: what counts as white, exactly at its limits, and the factors of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.pictures.written.looks import WhiteBalance, balance_by_patch, balance_by_white_photo

Singles = NDArray[np.float32]
ALONE = WhiteBalance((1.0, 1.0, 1.0), "camera")


def flat(colour: tuple[float, float, float], height: int = 10, width: int = 20) -> Singles:
    return np.full((height, width, 3), colour, np.float32)


def known(picture: Singles) -> NDArray[np.bool_]:
    return np.ones(picture.shape[:2], np.bool_)


@pytest.mark.parametrize(("red", "white"), [(1.5, True), (1.505, False)])
def test_neutral_is_at_most_half_as_strong_again(red: float, white: bool) -> None:
    picture = flat((red, 1.0, 1.25))
    found = balance_by_white_photo(picture, known(picture))
    assert found.source == ("white photo" if white else "camera")
    if white:
        np.testing.assert_allclose(found.factors, (1.0 / 1.5, 1.0, 0.8), rtol=1e-6)


@pytest.mark.parametrize(("height", "white"), [(10, True), (11, False)])
def test_white_takes_a_two_hundredth_of_the_picture(height: int, white: bool) -> None:
    picture = flat((3.0, 1.0, 1.0), height)
    picture[4, 4] = (2.0, 1.6, 2.0)
    found = balance_by_white_photo(picture, known(picture))
    assert (found.source == "white photo") == white
    if white:
        np.testing.assert_allclose(found.factors, (0.8, 1.0, 0.8), rtol=1e-6)


@pytest.mark.parametrize(("level", "counts"), [(1.0, True), (0.99, False)])
def test_white_is_at_least_half_as_bright_as_the_brightest(level: float, counts: bool) -> None:
    picture = flat((4.0, 1.0, 1.0))
    picture[:5] = np.array((0.8, 1.0, 1.2)) * level
    found = balance_by_white_photo(picture, known(picture))
    assert (found.source == "white photo") == counts


def test_the_brightest_is_what_a_hundredth_exceeds() -> None:
    """Two glints of 200 pixels do not make all else dark; the third one does."""
    picture = flat((0.9, 1.0, 1.0))
    picture[0, :2] = (90.0, 1.0, 1.0)
    assert balance_by_white_photo(picture, known(picture)).source == "white photo"
    picture[0, 2] = (90.0, 1.0, 1.0)
    assert balance_by_white_photo(picture, known(picture)) == ALONE


def test_what_is_unknown_or_black_is_not_white() -> None:
    picture = flat((1.0, 1.0, 2.0 / 1.5))
    seen = known(picture)
    seen[:, 3:] = False
    picture[:, 3:] = (8.0, 7.0, 9.0)
    np.testing.assert_allclose(
        balance_by_white_photo(picture, seen).factors, (1.0, 1.0, 0.75), rtol=1e-6
    )
    assert balance_by_white_photo(picture, ~known(picture)) == ALONE
    black = flat((0.0, 0.0, 0.0))
    assert balance_by_white_photo(black, known(black)) == ALONE


@pytest.mark.parametrize(
    ("place", "rows", "cols"),
    [
        ((0.5, 0.5), slice(23, 25), slice(31, 33)),
        ((0.25, 0.75), slice(35, 37), slice(15, 17)),
        ((0.51, 0.51), slice(23, 26), slice(31, 34)),
        ((0.0, 0.0), slice(0, 1), slice(0, 1)),
        ((1.0, 1.0), slice(47, 48), slice(63, 64)),
    ],
)
def test_a_patch_is_a_square_of_a_24th_of_the_height(
    place: tuple[float, float], rows: slice, cols: slice
) -> None:
    """Pixels that it touches, and no others."""
    rng = np.random.default_rng(0)
    picture = rng.uniform(0.5, 1.0, (48, 64, 3)).astype(np.float32)
    found = balance_by_patch(picture, known(picture), place)
    red, green, blue = picture[rows, cols].reshape(-1, 3).mean(axis=0, dtype=np.float64)
    assert found is not None and found.source == "patch"
    np.testing.assert_allclose(found.factors, (green / red, 1.0, green / blue), rtol=1e-9)


def test_a_dark_patch_is_no_white_one() -> None:
    picture = flat((5.0, 3.0, 2.0), 48, 64)
    picture[23:25, 31:33] = (0.5, 0.25, 0.25)  # a tenth, just
    assert balance_by_patch(picture, known(picture), (0.5, 0.5)) == WhiteBalance(
        (0.5, 1.0, 1.0), "patch"
    )
    picture[23:25, 31:33, 0] = 0.49
    assert balance_by_patch(picture, known(picture), (0.5, 0.5)) is None
    picture[23:25, 31:33] = (9.0, 0.0, 9.0)
    assert balance_by_patch(picture, known(picture), (0.5, 0.5)) is None
