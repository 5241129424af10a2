"""Focus: depth of stripes, photo after photo while somebody turns the rings, and when it ends."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from pdcd.calibration.figures import Verdict
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.registration.focus import measure_stripe_depth
from pdcd.calibration.registration.focus_step import watch_focus
from pdcd.calibration.script import PhotoRequest
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from tests.unit.calibration.scripted import Answered, Run, run, session_of
from tests.unit.planning.test_measured import config

FRAME = (192, 256)
PANEL = (256, 192)


def stripes(depth: float, period: float, right: float = 0.0) -> QuadPhoto:
    """Upright stripes of that depth, which is `right` times deeper at the right edge (ln)."""
    x = np.arange(FRAME[1]) + 0.5
    deeper = depth * np.exp(right * (x / FRAME[1] - 0.5))
    row = 1000.0 * (1.0 + deeper * np.cos(2.0 * np.pi * x / period))
    light = np.broadcast_to(row[None, :, None], (*FRAME, 3)).copy()
    return QuadPhoto(light, np.full(light.shape, 1.0))


def bench(placed: bool = True) -> Any:
    def place(size: tuple[int, int]) -> dict[str, Any]:
        return {"place": Placing(map=Map.filling(size))} if placed else {}

    return config(
        projector={"size_px": PANEL, **place(PANEL)},
        mask={"size_px": PANEL, **place(PANEL)},
        camera=place((FRAME[1], FRAME[0])),
    )


def focused(depths: dict[str, list[float]], right: float = 0.0) -> tuple[Answered, Run]:
    """Depths of the photos of either panel; the last one stays."""

    def answer(wanted: PhotoRequest) -> QuadPhoto:
        panel, number = wanted.shown.name.split("-")
        seen = depths[panel]
        return stripes(seen[min(int(number), len(seen)) - 1], 6.0, right)

    session = session_of(bench(), answer)
    session.full = 240
    return session, run(watch_focus(session))


def test_it_ends_when_three_photos_are_alike() -> None:
    _, found = focused({"mask": [0.9], "projector": [0.3, 0.6, 0.9, 0.91, 0.9]})
    names = [wanted.shown.name for wanted in found.wanted]
    assert names == [f"mask-{n}" for n in (1, 2, 3)] + [f"projector-{n}" for n in range(1, 6)]
    # Nobody is asked to turn a ring after the last photo of a panel.
    assert len(found.asked) == 2 + 4
    told = found.asked[3]
    assert told.now == pytest.approx(0.6, abs=0.02) and told.best == told.now
    assert found.outcome is not None and found.outcome.verdict is Verdict.GOOD
    assert [figure.name for figure in found.outcome.figures] == ["focus.mask", "focus.projector"]
    assert found.outcome.figures[1].value == pytest.approx(0.9, abs=0.02)
    assert not found.outcome.advice


@pytest.mark.parametrize(
    ("depths", "good"),
    [([0.9, 0.5, 0.85, 0.85, 0.85], True), ([0.9, 0.5, 0.7, 0.7, 0.7], False), ([0.5], False)],
)
def test_a_ring_may_stay_near_the_best_where_stripes_are_sharp(
    depths: list[float], good: bool
) -> None:
    _, found = focused({"mask": [0.9], "projector": depths})
    assert found.outcome is not None
    assert (found.outcome.figures[1].verdict is Verdict.GOOD) is good
    assert len(found.outcome.advice) == (not good)


def test_it_ends_after_fifteen_photos_of_a_panel() -> None:
    turned = [0.4, 0.8] * 10
    _, found = focused({"mask": turned, "projector": [0.9]})
    names = [wanted.shown.name for wanted in found.wanted]
    assert names[14] == "mask-15" and names[15] == "projector-1"
    assert found.asked[5].best == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize("right", [0.5, -0.5])
def test_sharpness_that_changes_over_the_field_is_a_tilt(right: float) -> None:
    _, found = focused({"mask": [0.8], "projector": [0.8]}, right=right)
    assert found.outcome is not None
    told = [text for text in found.outcome.advice if "something is tilted" in text]
    assert len(told) == 2
    assert f"by {right:+.1f} from left to right and +0.0" in told[0].replace("-0.0", "+0.0")


@pytest.mark.parametrize("scale", [0.64, 0.8, 1.0, 1.25])
def test_the_period_is_guessed_where_no_map_tells(scale: float) -> None:
    """A photo of twice as many quads as the panel has pixels, or a part of that."""
    session = session_of(bench(placed=False), lambda wanted: stripes(0.9, 8.0 * scale))
    session.full = 240
    found = run(watch_focus(session))
    assert found.outcome is not None
    assert found.outcome.figures[0].value == pytest.approx(0.9, abs=0.05)


def lying(photo: QuadPhoto) -> QuadPhoto:
    """The same by a camera that is turned by a quarter."""
    return QuadPhoto(photo.light.swapaxes(0, 1), photo.variance.swapaxes(0, 1))


@pytest.mark.parametrize("placed", [True, False])
def test_a_camera_turned_by_a_quarter_sees_the_stripes(placed: bool) -> None:
    bench_config = bench(placed)
    period = 8.0
    if placed:
        turned = (0.0, 1.0 / FRAME[1], 0.0, 1.0 / FRAME[0], 0.0, 0.0, 0.0, 0.0, 1.0)
        place = Placing(map=Map(size_px=FRAME, homography=turned))
        camera = msgspec.structs.replace(bench_config.camera, place=place)
        bench_config, period = msgspec.structs.replace(bench_config, camera=camera), 6.0
    session = session_of(bench_config, lambda wanted: lying(stripes(0.9, period)))
    session.full = 240
    found = run(watch_focus(session))
    assert found.outcome is not None and found.outcome.verdict is Verdict.GOOD
    assert found.outcome.figures[0].value == pytest.approx(0.9, abs=0.05)


Floats = NDArray[np.float64]

PERIOD = 5.3


def photo(
    blur_quads: Floats | float, seed: int = 0, turn: float = 0.05, electrons: float = 8000.0
) -> QuadPhoto:
    """Stripes, a little turned, of a lamp that falls off, with the noise of a camera.

    blur_quads : of the whole photo, or of each quad (120, 160).
    """
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    place = (x + turn * y) / np.hypot(1.0, turn)
    blur = np.maximum(np.broadcast_to(blur_quads, place.shape), 1e-3)
    light, within = np.zeros(place.shape), np.mod(place, PERIOD)
    for edge in PERIOD * np.arange(-3.0, 4.0):
        light += ndtr((within - edge) / blur) - ndtr((within - edge - 0.5 * PERIOD) / blur)
    light *= electrons * (1.0 - 0.3 * ((x / 160 - 0.5) ** 2 + (y / 120 - 0.5) ** 2))
    variance = 0.5 * (light + 16.8**2)
    light = light + rng.normal(size=light.shape) * np.sqrt(variance)
    return QuadPhoto(*(np.repeat(each[..., None], 3, axis=2) for each in (light, variance)))


def test_depth_is_that_of_blurred_stripes() -> None:
    sharp, soft = (
        measure_stripe_depth(photo(0.05), PERIOD),
        measure_stripe_depth(photo(1.2), PERIOD),
    )
    assert sharp.number == pytest.approx(4.0 / np.pi, rel=0.02)
    kept = np.exp(-2.0 * np.pi**2 * (1.2**2 - 0.05**2) / PERIOD**2)
    assert soft.number / sharp.number == pytest.approx(kept, rel=0.02)
    assert soft.number_sigma < 0.02 * soft.number


def test_what_is_wrong_is_named() -> None:
    plain = photo(1.0)
    with pytest.raises(CalibrationError, match="no light"):
        measure_stripe_depth(photo(1.0, electrons=0.0), PERIOD)
    with pytest.raises(CalibrationError, match="saturated"):
        measure_stripe_depth(replace(plain, saturated=plain.light[..., 1] > 4000.0), PERIOD)
    with pytest.raises(CalibrationError, match="no stripes"):
        measure_stripe_depth(photo(6.0), PERIOD)
    with pytest.raises(CalibrationError, match="no stripes"):
        measure_stripe_depth(plain, 3.0 * PERIOD)  # wider ones were shown
