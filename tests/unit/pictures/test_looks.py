"""How pictures are shown: what counts as white, and how brightly each is drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.pictures.written.looks import (
    Brightness,
    ToneStats,
    WhiteBalance,
    balance_by_patch,
    balance_by_white_photo,
)

Singles = NDArray[np.float32]
Colour = tuple[float, float, float]
ALONE = WhiteBalance((1.0, 1.0, 1.0), "camera")


def flat(colour: Colour, height: int = 10, width: int = 20) -> Singles:
    return np.full((height, width, 3), colour, np.float32)


def known(picture: Singles) -> NDArray[np.bool_]:
    return np.ones(picture.shape[:2], np.bool_)


@pytest.mark.parametrize(
    ("colour", "height", "place", "piece", "white"),
    [
        # Neutral is at most half as strong again in one channel.
        ((1.5, 1.0, 1.25), 10, np.s_[:0], ALONE.factors, True),
        ((1.505, 1.0, 1.25), 10, np.s_[:0], ALONE.factors, False),
        # A two-hundredth of the picture is enough.
        ((3.0, 1.0, 1.0), 10, np.s_[4, 4], (2.0, 1.6, 2.0), True),
        ((3.0, 1.0, 1.0), 11, np.s_[4, 4], (2.0, 1.6, 2.0), False),
        # White is at least half as bright as the brightest,
        ((4.0, 1.0, 1.0), 10, np.s_[:5], (0.8, 1.0, 1.2), True),
        ((4.0, 1.0, 1.0), 10, np.s_[:5], (0.79, 0.99, 1.19), False),
        # which two glints of 200 pixels are not, and three are.
        ((0.9, 1.0, 1.0), 10, np.s_[0, :2], (90.0, 1.0, 1.0), True),
        ((0.9, 1.0, 1.0), 10, np.s_[0, :3], (90.0, 1.0, 1.0), False),
    ],
)
def test_white_is_bright_and_nearly_neutral(
    colour: Colour, height: int, place: Any, piece: Colour, white: bool
) -> None:
    picture = flat(colour, height)
    picture[place] = piece
    found = balance_by_white_photo(picture, known(picture))
    assert found.source == "white photo" if white else found == ALONE


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


@pytest.mark.parametrize(
    ("bright", "sigma", "factor"),
    [
        (0.3, 0.0, 2.0), (0.3001, 0.0, 1.0), (0.2999, 0.0, 2.0), (0.15, 0.0, 4.0),
        (2.4, 0.0, 0.25), (1e-9, 0.0, 4096.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 1.0),
        # Noise is shown as an eighth of white at most; a scene unit is shown as 1.5.
        (1e-3, 0.0104, 8.0), (1e-3, 0.0105, 4.0), (1e-3, 0.5, 1.0), (1e-3, 0.0, 512.0),
    ],
)  # fmt: skip
def test_factors_are_powers_of_two_that_reach_the_level(
    bright: float, sigma: float, factor: float
) -> None:
    shown = Brightness({"white": ToneStats(0.6, 0.0), "it": ToneStats(bright, sigma)})
    assert shown.factor("it") == factor


def test_a_run_of_noise_is_not_shown_as_light() -> None:
    assert Brightness({"white": ToneStats(0.1, 0.125)}).scale == pytest.approx(1.0)
    assert Brightness({"white": ToneStats(0.9, 0.1)}).scale == pytest.approx(1.0)
    assert Brightness({"it": ToneStats(0.0, 0.0)}).scale == 1.0
    assert Brightness({"it": ToneStats(-2.0, 0.0)}).scale == 1.0


@pytest.mark.parametrize(
    ("dark", "sigma", "signed"),
    [(-0.25, 0.0, False), (-0.26, 0.0, True), (-0.5, 0.125, False), (-0.51, 0.125, True)],
)
def test_a_picture_is_signed_by_clear_light_below_zero(
    dark: float, sigma: float, signed: bool
) -> None:
    assert Brightness({"it": ToneStats(1.0, sigma, dark)}).signed("it") == signed


def test_a_look_is_the_darkest_and_the_brightest_hundredth_of_what_is_known() -> None:
    image = np.repeat(np.arange(1001.0)[:, None, None], 3, axis=2) + 500.0
    seen = np.ones((1001, 1), np.bool_)
    look = ToneStats.of(image, seen, 0.25)
    assert look.dark == pytest.approx(510.0, abs=0.5)
    assert look.bright == pytest.approx(1490.0, abs=0.5)
    assert look.sigma == 0.25
    seen[501:] = False
    assert ToneStats.of(image, seen, 0.25).bright == pytest.approx(995.0, abs=0.5)
    assert ToneStats.of(image, np.zeros((1001, 1), np.bool_), 0.25) == ToneStats(0.0, 0.25)


@pytest.mark.parametrize(
    ("levels", "bright"),
    [
        ([(94, 0.01), (6, 2.0)], 2.0),  # more than a twentieth: lit on purpose
        ([(96, 0.01), (4, 2.0)], 0.125),  # glints, cut off at a sixteenth of what they reach
        ([(60, 0.01), (36, 0.5), (4, 2.0)], 0.5),  # or at what the brightest twentieth reaches
        ([(96, 0.05), (4, 2.0)], 2.0),  # half of it is shown brightly enough
        ([(96, 0.044), (4, 2.0)], 0.125),
    ],
)
def test_few_glints_do_not_decide(levels: list[tuple[int, float]], bright: float) -> None:
    column = np.concatenate([np.full(count, level) for count, level in levels])
    picture = np.repeat(column[:, None, None], 3, axis=2)
    assert ToneStats.of(picture, np.ones((column.size, 1), np.bool_), 0.0).bright == (
        pytest.approx(bright)
    )
