"""Pictures of a page: how large they get, what their sigma means when they were shrunk."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.maps.map import Map
from pdcd.pictures.sigma import Barred
from pdcd.pictures.upright import View
from pdcd.report import layers
from pdcd.report.packing import size_bytes

LARGE = 1424, 2136
"""Quads of a body of 4272 x 2848 samples."""
MOST_BYTES = 12_000_000


def noisy(frame: tuple[int, int], seed: int, code: float = 0.0) -> Barred:
    """Shot noise over a bright gradient: where it is bright, far above the usual step."""
    rng = np.random.default_rng(seed)
    light = np.linspace(0.01, 1.0, frame[1])[None, :, None] ** 2 * np.ones((*frame, 3))
    sensor = (0.01 * np.sqrt(light)).astype(np.float32)
    image = light + sensor * rng.standard_normal(light.shape)
    error = np.full(light.shape, code, np.float32)
    return Barred(image, np.hypot(sensor, error), sensor, error, "modelled")


@pytest.mark.long
@pytest.mark.parametrize("count", [3, 8])
def test_a_page_of_a_large_run_stays_below_twelve_megabytes(count: int) -> None:
    names = ["white", *map(str, range(1, count))]
    pictures = {name: noisy(LARGE, seed) for seed, name in enumerate(names)}
    truth = layers.Truth(pictures["white"].image, np.ones(LARGE, np.bool_))
    made = layers.layers(pictures, View(Map.filling(LARGE[::-1]), 1.5), truth)
    total = sum(
        size_bytes(one[part]) for one in made.data for part in ("values", "sigma") if one[part]
    )
    assert total < 0.95 * MOST_BYTES and len(made.data) == count + 1


def test_sigma_of_a_shrunk_picture_is_that_of_the_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise of the sensor averages out, the error of the codes does not."""
    monkeypatch.setattr(layers, "MOST_PX", 30)
    shown: dict[str, NDArray[np.floating]] = {}
    monkeypatch.setattr(
        layers, "logarithmic", lambda values: shown.setdefault("sigma", values) is None
    )
    picture = noisy((80, 120), 0, code=0.004)
    made = layers.layers({"white": picture}, View(Map.filling((120, 80)), 1.5), None)
    assert made.size_px == (30, 20) and made.quads == 16.0
    sensor = picture.sensor.reshape(20, 4, 30, 4, 3)
    wanted = np.hypot(np.sqrt((sensor**2).mean(axis=(1, 3)) / 16.0), 0.004)
    np.testing.assert_allclose(shown["sigma"], np.moveaxis(wanted, -1, 0), rtol=0.15)


def flat(colour: tuple[float, float, float], patch: tuple[float, float, float]) -> Barred:
    """Of one colour, but for a patch in the upper left quarter."""
    image = np.ones((40, 60, 3)) * colour
    image[:20, :30] = patch
    sigma = np.full(image.shape, 1e-3, np.float32)
    return Barred(image, sigma, sigma, 0.0 * sigma, "modelled")


@pytest.mark.parametrize(
    ("names", "place", "neutral"),
    [
        (["white", "indirect"], None, (1.0, 0.8, 0.9)),  # what is bright in the white photo
        (["indirect", "white"], (0.2, 0.2), (0.4, 0.4, 0.2)),  # the patch in it
        (["indirect"], (0.2, 0.2), (0.04, 0.04, 0.02)),  # the patch in the answer
        (["indirect"], None, (1.0, 1.0, 1.0)),  # nothing tells of it: the camera's own
    ],
)
def test_colours_of_a_page_are_balanced_by_what_is_white(
    names: list[str], place: tuple[float, float] | None, neutral: tuple[float, float, float]
) -> None:
    seen = {
        "white": flat((1.0, 0.8, 0.9), (0.4, 0.4, 0.2)),
        "indirect": flat((0.3, 0.2, 0.1), (0.04, 0.04, 0.02)),
    }
    view = View(Map.filling((60, 40)), 1.5, place)
    made = layers.layers({name: seen[name] for name in names}, view, None)
    balanced = np.multiply(made.balance, neutral)
    np.testing.assert_allclose(balanced, balanced[1], rtol=1e-5)
