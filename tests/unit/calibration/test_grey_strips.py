"""Light of grey levels out of strips without noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.figures import Verdict
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.response.levels import (
    NO_STRIP,
    STRIP_LEVELS,
    GreyResponse,
    draw_level_pictures,
    find_level_strip,
    make_strip_orders,
    measure_grey_response,
)
from pdcd.errors import CalibrationError

Floats = NDArray[np.float64]

QUADS = 40
STRIPS = np.repeat(np.arange(17, dtype=np.int32), QUADS)[None, :]
GREY = np.array(STRIP_LEVELS) / 255.0
WHITE = 1000.0


def photos(
    light: Floats, *, sigma: float = 1e-3, full: Floats | float = 1.0
) -> dict[str, QuadPhoto]:
    """Strips that show `light` (17,) of each level over white, which is `full` at each strip."""

    def photo(of_strips: Floats) -> QuadPhoto:
        seen = np.repeat(of_strips, QUADS)[None, :, None] * np.array([0.7, 1.0, 0.8]) * WHITE
        return QuadPhoto(seen, np.full(seen.shape, (sigma * WHITE) ** 2))

    full = np.broadcast_to(full, 17)
    found = {"white": photo(full), "black": photo(light[0] * full)}
    for name, order in zip(("steps-a", "steps-b"), make_strip_orders(), strict=True):
        found[name] = photo(light[order] * full)
    return found


def gamma_of(gamma: float, black: float = 0.0) -> Floats:
    return np.asarray(black + (1.0 - black) * GREY**gamma)


@pytest.mark.parametrize("gamma", [0.5, 1.0, 2.2])
@pytest.mark.parametrize("black", [0.0, 0.1])
def test_light_is_told_from_black_to_white(gamma: float, black: float) -> None:
    found = measure_grey_response(photos(gamma_of(gamma, black)), STRIPS, "mask")
    assert found.panel == "mask" and found.levels.tolist() == list(map(float, STRIP_LEVELS))
    np.testing.assert_allclose(found.light, GREY**gamma, atol=1e-12)
    assert found.gamma == pytest.approx(gamma, rel=1e-5)
    assert found.channel_gammas == pytest.approx((gamma,) * 3, rel=1e-5)
    assert found.misfit < 1e-5 and 0.0 < found.gamma_sigma < 1e-2
    assert {figure.verdict for figure in found.figures()} == {Verdict.GOOD}


def test_errors_are_those_of_a_strip_and_of_both_that_it_is_scaled_by() -> None:
    """Each ratio has the noise of 40 quads of the strip, of the white photo and of the black one,
    in three colours; two orders halve the variance."""
    light = gamma_of(1.0)
    found = measure_grey_response(photos(light, sigma=0.01), STRIPS)
    sums = np.array([0.7, 1.0, 0.8])
    noise2 = np.array(
        [
            np.mean(0.01**2 * (1.0 + ratio**2 + (1.0 - ratio) ** 2) / sums**2) / 3.0 / QUADS
            for ratio in light
        ]
    )
    wanted = np.sqrt((noise2 + light**2 * noise2[-1] + (1.0 - light) ** 2 * noise2[0]) / 2.0)
    np.testing.assert_allclose(found.sigma[1:-1], wanted[1:-1], rtol=1e-6)


@pytest.mark.parametrize("room", [0.02, 0.05])
def test_room_light_beside_a_projector_that_falls_off_to_its_corners(room: float) -> None:
    """The same light everywhere on a white that is a third less at the ends: gamma was 2 % off."""
    white = 1.0 - 0.35 * np.linspace(-1.0, 1.0, 17) ** 2
    given = photos(gamma_of(1.0), full=white)
    for photo in given.values():
        photo.light[...] += room * WHITE * np.array([0.7, 1.0, 0.8])
    found = measure_grey_response(given, STRIPS)
    np.testing.assert_allclose(found.light, GREY, atol=1e-12)
    assert found.gamma == pytest.approx(1.0, abs=1e-5)


def made(light: Floats) -> GreyResponse:
    levels = np.array(STRIP_LEVELS, np.float64)
    return GreyResponse("mask", levels, light, np.zeros(17), 1.0, 0.01, (1.0, 1.2, 0.9), 0.0)


@pytest.mark.parametrize("law", [lambda g: g, lambda g: g**2.2, lambda g: g**0.45])
def test_the_level_for_a_light_is_the_nearest(law: Callable[[Floats], Floats]) -> None:
    found = made(law(GREY))
    light = found.light_of()
    assert light.shape == (256,) and light[np.array(STRIP_LEVELS)] == pytest.approx(law(GREY))
    levels = found.level_for()
    assert levels.dtype == np.uint8
    for k in range(256):
        away = np.abs(light - k / 255.0)
        assert away[levels[k]] == pytest.approx(away.min(), abs=1e-12)


def test_strips_are_of_one_width_from_edge_to_edge() -> None:
    assert find_level_strip([-5.0, 0.0, 9.99, 10.0, 169.9, 170.0, 999.0], 170).tolist() == [
        0, 0, 0, 1, 16, 16, 16,
    ]  # fmt: skip
    white, black, *steps = draw_level_pictures((170, 4)).values()
    assert (white == 255).all() and white.shape == (4, 170) and not black.any()
    for picture, order in zip(steps, make_strip_orders(), strict=True):
        assert picture[2, ::10].tolist() == [STRIP_LEVELS[n] for n in order]


def test_light_beyond_black_and_white_is_cut_off() -> None:
    light = made(np.concatenate([[0.0, -0.1], GREY[2:-2], [1.1, 1.0]])).light_of()
    assert light.min() == 0.0 and light.max() == 1.0 and (np.diff(light) >= 0.0).all()


@pytest.mark.parametrize(("fall", "refused"), [(0.021, False), (0.3, True)])
def test_a_level_falls_where_it_does_so_by_more_than_noise(fall: float, refused: bool) -> None:
    light = gamma_of(1.0)
    light[9] = light[8] - fall
    if not refused:
        measure_grey_response(photos(light, sigma=0.05), STRIPS)
        return
    with pytest.raises(CalibrationError, match=f"from level {STRIP_LEVELS[8]} to level"):
        measure_grey_response(photos(light, sigma=0.05), STRIPS)


def test_a_strip_that_is_not_seen_is_named() -> None:
    strips = np.where(STRIPS == 3, NO_STRIP, STRIPS)
    with pytest.raises(CalibrationError, match="strip 4 of 17 is seen by 0 pixels"):
        measure_grey_response(photos(gamma_of(2.2)), strips)
