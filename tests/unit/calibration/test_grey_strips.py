"""Light of grey levels out of strips without noise, at the edges of what is borne."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.figures import Verdict
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.response.levels import (
    NO_STRIP,
    STRIP_LEVELS,
    GreyResponse,
    find_level_strip,
    make_strip_orders,
    measure_grey_response,
    plan_level_photos,
)
from pdcd.errors import CalibrationError

Floats = NDArray[np.float64]

QUADS = 40
STRIPS = np.repeat(np.arange(17, dtype=np.int32), QUADS)[None, :]
GREY = np.array(STRIP_LEVELS) / 255.0
WHITE = 1000.0


def photos(
    light: Floats | tuple[Floats, Floats],
    *,
    sigma: float = 1e-3,
    white: Floats | None = None,
    colours: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> dict[str, QuadPhoto]:
    """Strips that show `light` (17,) of each level over white, of either order."""
    full = np.full(17, 1.0) if white is None else white

    def photo(of_strips: Floats) -> QuadPhoto:
        seen = np.repeat(of_strips, QUADS)[None, :, None] * np.array([0.7, 1.0, 0.8]) * WHITE
        return QuadPhoto(seen, np.full(seen.shape, (sigma * WHITE) ** 2))

    both = light if isinstance(light, tuple) else (light, light)
    found = {"white": photo(full), "black": photo(both[0][0] * full)}
    for name, order, levels in zip(("steps-a", "steps-b"), make_strip_orders(), both, strict=True):
        found[name] = photo(levels[order] * full)
        found[name].light[...] *= np.array(colours)
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
    assert (found.sigma[0], found.sigma[-1]) == (0.0, 0.0)
    told = {figure.name: figure for figure in found.figures()}
    assert told["mask.gamma"].verdict is Verdict.GOOD
    assert told["mask.gamma"].limit == "a power law within 0.01"
    assert told["mask.gamma_colours"].value == pytest.approx(0.0, abs=1e-4)
    assert told["mask.gamma_misfit"].sigma == float(found.sigma.max())


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
    given = photos(gamma_of(1.0), white=white)
    for photo in given.values():
        photo.light[...] += room * WHITE * np.array([0.7, 1.0, 0.8])
    found = measure_grey_response(given, STRIPS)
    np.testing.assert_allclose(found.light, GREY, atol=1e-12)
    assert found.gamma == pytest.approx(1.0, abs=1e-5)


def test_black_may_have_a_fifth_of_the_light() -> None:
    assert measure_grey_response(photos(gamma_of(1.0, 0.19)), STRIPS).gamma == pytest.approx(
        1.0, abs=1e-4
    )


def made(light: Floats, **more: Any) -> GreyResponse:
    given: dict[str, Any] = {
        "panel": "mask", "levels": np.array(STRIP_LEVELS, np.float64), "light": light,
        "sigma": np.zeros(17), "gamma": 1.0,
        "gamma_sigma": 0.01, "channel_gammas": (1.0, 1.2, 0.9), "misfit": 0.0, **more,
    }  # fmt: skip
    return GreyResponse(**given)


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
    white, black, first, second = plan_level_photos("projector", (170, 4), 100, cycle=30)
    names = (white.name, black.name, first.name, second.name)
    assert names == ("white", "black", "steps-a", "steps-b") and not black.levels.any()
    assert {white.refreshes, first.refreshes, second.refreshes} == {120}
    assert (white.levels == 255).all() and white.levels.shape == (4, 170)
    for steps, order in zip((first, second), make_strip_orders(), strict=True):
        assert steps.levels[2, ::10].tolist() == [STRIP_LEVELS[n] for n in order]
        assert steps.panel == "projector"


def test_light_beyond_black_and_white_is_cut_off() -> None:
    light = made(np.concatenate([[0.0, -0.1], GREY[2:-2], [1.1, 1.0]])).light_of()
    assert light.min() == 0.0 and light.max() == 1.0 and (np.diff(light) >= 0.0).all()


def fallen(fall: float, **more: Any) -> dict[str, QuadPhoto]:
    """Level 9 gives less light than level 8."""
    light = gamma_of(1.0)
    light[9] = light[8] - fall
    return photos(light, **more)


def apart(many: int) -> dict[str, QuadPhoto]:
    """Two orders of strips that disagree by a fifth of the light, at `many` levels."""
    light = gamma_of(1.0)
    other = light.copy()
    other[-1 - many : -1] -= 0.2 * np.where(np.arange(many) % 2, 1.0, 0.999)
    return photos((light, other))


def shaded(share: float) -> dict[str, QuadPhoto]:
    """A strip with `share` of the mean white light of all."""
    white = np.ones(17)
    white[6] = share * (16.0 / (17.0 - share))
    return photos(gamma_of(2.2), white=white)


@pytest.mark.parametrize(
    ("borne", "refused", "words"),
    [
        (photos((GREY, 1.029 * GREY)), photos((GREY, 1.032 * GREY)), "the lamp changed by +3"),
        (photos((GREY, 0.971 * GREY)), photos((GREY, 0.968 * GREY)), "the lamp changed by -3"),
        (apart(0), apart(4), "two orders of strips disagree by"),
        (fallen(0.019), fallen(0.021), f"from level {STRIP_LEVELS[8]} to level {STRIP_LEVELS[9]}"),
        (fallen(0.021, sigma=0.05), fallen(0.3, sigma=0.05), "light falls from level"),
        (shaded(0.11), shaded(0.09), "strip 7 of 17 is dark in the white photo"),
        (photos(GREY, sigma=0.075), photos(GREY, sigma=0.12), "too dim: a strip is known to"),
        (photos(gamma_of(1.0, 0.19)), photos(gamma_of(1.0, 0.21)), "black strips have 21 % of"),
    ],
)
def test_strips_are_refused_just_beyond_what_is_borne(
    borne: dict[str, QuadPhoto], refused: dict[str, QuadPhoto], words: str
) -> None:
    measure_grey_response(borne, STRIPS)
    with pytest.raises(CalibrationError) as caught:
        measure_grey_response(refused, STRIPS)
    assert words in str(caught.value)


def test_strips_need_thirty_quads() -> None:
    strips = STRIPS.copy()
    strips[0, 3 * QUADS + 30 : 4 * QUADS] = NO_STRIP
    measure_grey_response(photos(gamma_of(2.2)), strips)
    strips[0, 3 * QUADS + 29] = NO_STRIP
    with pytest.raises(CalibrationError, match="strip 4 of 17 is seen by 29 pixels"):
        measure_grey_response(photos(gamma_of(2.2)), strips)
