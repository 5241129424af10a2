"""Grey levels of panels whose light is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pdcd.calibration.figures import Verdict
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.response.levels import (
    GreyResponse,
    draw_level_pictures,
    find_seen_strips,
    make_strip_orders,
    measure_grey_response,
)
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map
from tests.unit.calibration.light_bench import LightBench

Floats = NDArray[np.float64]
Law = Callable[[Floats], Floats]

PANEL = (255, 190)
SHAPE = (120, 170)
BENCH = LightBench(shape=SHAPE)
WHITE_E = 25000.0
TURN = np.radians(4.0)
CAMERA = Map(
    size_px=(SHAPE[1], SHAPE[0]),
    homography=(
        0.9 * np.cos(TURN) / SHAPE[1],
        -0.9 * np.sin(TURN) / SHAPE[0],
        0.09,
        0.9 * np.sin(TURN) / SHAPE[1],
        0.9 * np.cos(TURN) / SHAPE[0],
        0.02,
        0.0,
        0.0,
        1.0,
    ),
)
STRIPS = find_seen_strips(CAMERA, Map.filling(PANEL))


def power(gamma: float) -> Law:
    return lambda grey: grey**gamma


def s_curve(grey: Floats) -> Floats:
    return np.asarray((np.tanh(4.0 * (grey - 0.55)) + np.tanh(2.2)) / (np.tanh(1.8) + np.tanh(2.2)))


def where_seen() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels of the panel that the quads see, by the homography written out."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    h = np.array(CAMERA.homography).reshape(3, 3)
    u, v = h[0, 0] * x + h[0, 1] * y + h[0, 2], h[1, 0] * x + h[1, 1] * y + h[1, 2]
    return np.floor(v * PANEL[1]).astype(int), np.floor(u * PANEL[0]).astype(int)


def series(
    law: Law,
    seed: int = 0,
    *,
    leak: float = 1 / 800,
    room: float = 0.01,
    lamp: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0),
    scale: float = 1.0,
    flip: bool = False,
    uneven: float = 0.0,
    blur: float = 0.8,
    covered: int = 0,
) -> dict[str, QuadPhoto]:
    """Photos of a panel that follows `law`; `uneven` is an error of the white photo."""
    rng = np.random.default_rng(seed)
    rows, cols = where_seen()
    inside = (rows >= 0) & (rows < PANEL[1]) & (cols >= 0) & (cols < PANEL[0])
    photos = {}
    for (name, picture), level in zip(draw_level_pictures(PANEL).items(), lamp, strict=True):
        shown = picture[:, ::-1] if flip else picture
        grey = shown[np.clip(rows, 0, PANEL[1] - 1), np.clip(cols, 0, PANEL[0] - 1)] / 255.0
        light = level * (leak + (1.0 - leak) * law(grey)) * inside + room
        light[:, :covered] = 0.0
        light = gaussian_filter(light, blur)[..., None] * BENCH.vignetting()
        if name == "white":
            light = (
                light * (1.0 + uneven * gaussian_filter(rng.standard_normal(SHAPE), 4))[..., None]
            )
        light = scale * WHITE_E * light * np.array([0.7, 1.0, 0.8])
        photos[name] = BENCH.photo(light, rng)
    return photos


def measured(photos: dict[str, QuadPhoto]) -> GreyResponse:
    return measure_grey_response(photos, STRIPS)


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_finds_gamma(gamma: float) -> None:
    found = measured(series(power(gamma), 1))
    assert found.gamma == pytest.approx(gamma, abs=min(0.02, 5 * found.gamma_sigma + 1e-4))
    assert found.channel_gammas == pytest.approx((gamma,) * 3, abs=0.02)
    assert np.abs(found.light_of() - (np.arange(256) / 255.0) ** gamma).max() < 0.004
    assert max(f.verdict for f in found.figures()) == Verdict.GOOD


@pytest.mark.long
def test_errors_are_those_it_tells() -> None:
    pulls, lights = [], []
    for seed in range(10):
        found = measured(series(power(2.2), 200 + seed))
        pulls.append((found.gamma - 2.2) / found.gamma_sigma)
        truth = (found.levels / 255.0) ** 2.2
        lights += list((found.light - truth)[1:-1] / found.sigma[1:-1])
    assert 0.5 < float(np.std(pulls)) < 1.6
    assert 0.6 < float(np.std(lights)) < 1.4


def test_an_uneven_white_photo_widens_the_errors() -> None:
    clean = measured(series(power(2.2), 3))
    uneven = measured(series(power(2.2), 3, uneven=0.2))
    assert uneven.gamma_sigma > 2.0 * clean.gamma_sigma
    assert abs(uneven.gamma - 2.2) < 4.0 * uneven.gamma_sigma


def test_a_curve_that_is_no_power_has_a_table() -> None:
    found = measured(series(s_curve, 4))
    grey = np.arange(256) / 255.0
    truth = s_curve(grey)
    assert np.abs(found.light_of() - (truth - truth[0]) / (truth[-1] - truth[0])).max() < 0.006
    assert found.figures()[0].verdict == Verdict.DOUBTFUL
    levels = found.level_for()
    assert (levels[0], levels[255]) == (0, 255)
    assert np.all(np.diff(levels.astype(int)) >= 0)
    shown = (s_curve(levels / 255.0) - truth[0]) / (truth[-1] - truth[0])
    assert np.abs(shown - grey).max() < 0.015  # the steps of 8 bits where the curve is steep


@pytest.mark.parametrize(
    ("bench", "words"),
    [
        ({"scale": 0.0}, "no photo shows any light|no light"),
        ({"scale": 2.0}, "saturated"),
        ({"scale": 0.0003}, "too dim|no photo"),
        ({"blur": 9.0}, "orders of strips disagree.*focus"),
        ({"covered": 70}, "is dark in the white photo.*covers"),
        ({"flip": True}, "orders of strips disagree.*mirrored"),
        ({"lamp": (1.0, 1.0, 1.0, 0.9)}, "lamp changed"),
        ({"law": lambda grey: np.ones_like(grey)}, "equally bright"),
        ({"law": lambda grey: 1.0 - grey**2.2}, "inverted"),
        ({"law": lambda grey: (grey > 0.5).astype(float)}, "black and white only"),
        ({"law": lambda grey: grey - 0.3 * np.sin(np.pi * grey) ** 8}, "light falls"),
        ({"room": 0.6, "scale": 0.6}, "room"),
    ],
)
def test_bad_input_has_a_named_cause(bench: dict[str, object], words: str) -> None:
    asked = {"law": power(2.2)} | bench
    with pytest.raises(CalibrationError, match=words):
        measured(series(**asked))  # type: ignore[arg-type]


def test_orders_show_every_level_and_a_mirror() -> None:
    first, second = make_strip_orders()
    for order in (first, second):
        assert sorted(order) == list(range(17))
        assert np.abs(np.diff(order)).min() > 1
    # Seen mirrored, a level gets other light from one order than from the other.
    seen = [order[::-1][np.argsort(order)] for order in (first, second)]
    assert np.all(seen[0] != seen[1])
