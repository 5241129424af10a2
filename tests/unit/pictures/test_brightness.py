"""How brightly pictures are shown: scale, factors and signs of made-up looks."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.pictures.written.looks import (
    Brightness,
    ToneStats,
)


@pytest.mark.parametrize(
    ("bright", "factor"),
    [
        (0.3, 2.0), (0.3 * (1.0 + 1e-7), 2.0), (0.3001, 1.0), (0.2999, 2.0), (0.15, 4.0),
        (2.4, 0.25), (0.6 / 4096.0, 4096.0), (1e-9, 4096.0), (0.0, 1.0), (-1.0, 1.0),
    ],
)  # fmt: skip
def test_factors_are_powers_of_two_that_reach_the_level(bright: float, factor: float) -> None:
    shown = Brightness({"white": ToneStats(0.6, 0.0), "it": ToneStats(bright, 0.0)})
    assert shown.factor("it") == factor


@pytest.mark.parametrize(
    ("sigma", "factor"),
    [(0.01, 8.0), (0.0104, 8.0), (0.0105, 4.0), (0.09, 1.0), (0.5, 1.0), (0.0, 512.0)],
)
def test_noise_is_shown_as_an_eighth_of_white_at_most(sigma: float, factor: float) -> None:
    """A scene unit is shown as 1.5: what is as dark as a thousandth could be 600 times brighter."""
    shown = Brightness({"white": ToneStats(0.6, 0.0), "it": ToneStats(1e-3, sigma)})
    assert shown.factor("it") == factor


def test_a_run_of_noise_is_not_shown_as_light() -> None:
    assert Brightness({"white": ToneStats(0.1, 0.125)}).scale == pytest.approx(1.0)
    assert Brightness({"white": ToneStats(0.9, 0.1)}).scale == pytest.approx(1.0)
    assert Brightness({"it": ToneStats(0.0, 0.0)}).scale == 1.0
    assert Brightness({"it": ToneStats(-2.0, 0.0)}).scale == 1.0


@pytest.mark.parametrize(
    ("dark", "sigma", "signed"),
    [
        (-0.25, 0.0, False), (-0.26, 0.0, True), (-0.5, 0.125, False), (-0.51, 0.125, True),
        (0.5, 0.0, False),
    ],
)  # fmt: skip
def test_a_picture_is_signed_by_clear_light_below_zero(
    dark: float, sigma: float, signed: bool
) -> None:
    look = ToneStats(1.0, sigma, dark)
    assert look.signed == signed
    assert Brightness({"it": look}).signed("it") == signed


def picture(levels: list[tuple[int, float]]) -> tuple[np.ndarray, np.ndarray]:
    """A column of pixels, so many of each level, and all of them known."""
    column = np.concatenate([np.full(count, level) for count, level in levels])
    return np.repeat(column[:, None, None], 3, axis=2), np.ones((column.size, 1), np.bool_)


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
    assert ToneStats.of(*picture(levels), 0.0).bright == pytest.approx(bright)
