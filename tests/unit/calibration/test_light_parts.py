"""Flat field, lamp, glare and polariser, each with what it must refuse."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pdcd.calibration.figures import Verdict
from pdcd.calibration.light.contrasts import Share
from pdcd.calibration.light.flat import flat_of
from pdcd.calibration.light.glare import CELL_PX, Glare, glare_of, glare_photo
from pdcd.calibration.light.lamp import iris_of, iris_photos, lamp_of
from pdcd.calibration.light.light_plan import LightPlan
from pdcd.calibration.photo import Photo
from pdcd.errors import CalibrationError
from tests.unit.calibration.light_bench import LightBench

Floats = NDArray[np.float64]

SHAPE = (192, 256)
BENCH = LightBench(shape=SHAPE)
WHITE_E = 25000.0


def photo(light: Floats, seed: int = 0) -> Photo:
    """Of expected electrons (h, w, 1 or 3)."""
    full = np.broadcast_to(light, (*light.shape[:2], 3)).copy()
    return BENCH.photo(full, np.random.default_rng(seed))


def card() -> Floats:
    return np.asarray(WHITE_E * BENCH.vignetting() * np.array([0.7, 1.0, 0.8]))


# --- flat field -----------------------------------------------------------------------------------


def test_flat_is_the_vignetting_and_finds_dust() -> None:
    light = card()
    light[80:104, 40:64] *= 0.9
    flat = flat_of(photo(light, 1))
    truth = np.broadcast_to(BENCH.vignetting(), (*SHAPE, 3))
    assert np.abs(flat.rows(0, 192) / truth - 1.0).max() < 0.003
    assert flat.rows(90, 91) == pytest.approx(flat.rows(0, 192)[90:91])
    assert flat.dust[10:13, 5:8].all()
    assert flat.dust.sum() <= 9 + 4
    assert flat.least == pytest.approx(0.72, abs=0.01)  # of the outermost blocks' centres
    assert flat.figures()[1].verdict == Verdict.DOUBTFUL


def test_the_pictures_edge_along_that_of_the_photo_is_no_dust() -> None:
    """Three quads of the last row of blocks are dark: what is left of it is no light of a card."""
    light = card()
    light[-3:] *= 0.05
    flat = flat_of(photo(light, 3))
    assert not flat.lit[-1].any() and flat.lit[-2].all()
    assert not flat.dust.any()


@pytest.mark.parametrize("blur_quads", [0.4, 0.7, 1.5])
def test_a_blurred_edge_of_the_picture_along_that_of_the_photo_is_no_dust(
    blur_quads: float,
) -> None:
    """The picture ends where the photo does. The surface is that of the card up to there, and a
    speck at the border is still one."""
    light = card()
    light[40:48, :8] *= 0.95
    dark = gaussian_filter(np.pad(light, ((8, 8), (8, 8), (0, 0))), (blur_quads, blur_quads, 0))
    flat = flat_of(photo(dark[8:-8, 8:-8], 5))
    assert not flat.dust.any() and flat.lit[1:-1, 1:-1].all()
    assert np.abs(flat.rows(0, 192) / BENCH.vignetting() - 1.0)[8:-8, 8:-8].max() < 0.004
    assert flat_of(photo(light, 5)).dust[5, 0]


def test_flat_takes_the_room_off() -> None:
    room = 2000.0 * np.linspace(0.0, 1.0, 256)[None, :, None] * np.ones((192, 1, 3))
    flat = flat_of(photo(card() + room, 2), without=room / 2.96)
    assert np.abs(flat.rows(0, 192) / BENCH.vignetting() - 1.0).max() < 0.004


def test_flat_refuses_what_is_no_card() -> None:
    rng = np.random.default_rng(4)
    texture = 0.5 + gaussian_filter(rng.random((*SHAPE, 1)), (6, 6, 0)) - 0.5
    with pytest.raises(CalibrationError, match="no even card"):
        flat_of(photo(card() * (0.6 + 4.0 * (texture - texture.mean()))))
    with pytest.raises(CalibrationError, match="lens cap"):
        flat_of(photo(0.0 * card()))
    with pytest.raises(CalibrationError, match="saturated"):
        flat_of(photo(3.0 * card()))
    small = card()
    small[40:] = 0.0
    with pytest.raises(CalibrationError, match="a card must fill the field"):
        flat_of(photo(small))


# --- lamp -----------------------------------------------------------------------------------------


def test_lamp_drift_and_flicker() -> None:
    rng = np.random.default_rng(5)
    times = 10.0 * np.arange(20.0)
    pulls, flickers = [], []
    for _ in range(30):
        levels = 5000.0 * (1.0 - 0.1 * times / 3600.0) * (1.0 + 0.002 * rng.standard_normal(20))
        lamp = lamp_of(times, levels)
        pulls.append((lamp.drift_per_h + 0.1) / lamp.drift_sigma)
        flickers.append(lamp.flicker)
    assert 0.7 < float(np.std(pulls)) < 1.4
    assert float(np.mean(flickers)) == pytest.approx(0.002, rel=0.1)
    assert lamp.figures()[1].verdict == Verdict.GOOD


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        (np.array([1.0, 1.1, 0.9, 1.1, 0.9, 1.0]), "unstable: it flickers"),
        (np.array([1.0, 0.96, 0.92, 0.88, 0.84, 0.80]), "unstable"),
        (np.array([1.0, 1.0, 0.01, 1.0, 1.0, 1.0]), "photo 3 of the series is dark.*shutter"),
        (np.array([1.0, 1.0]), "2 photos do not tell"),
    ],
)
def test_lamp_that_is_none(levels: Floats, words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        lamp_of(10.0 * np.arange(float(levels.size)), 4000.0 * levels)


def seen(pattern: Floats, blur: float = 1.5) -> Floats:
    """A panel's pattern at the camera, (h, w, 1): scaled, blurred."""
    rows = (np.arange(SHAPE[0]) + 0.5) * pattern.shape[0] / SHAPE[0]
    cols = (np.arange(SHAPE[1]) + 0.5) * pattern.shape[1] / SHAPE[1]
    picked = pattern[rows.astype(int)[:, None], cols.astype(int)[None, :]]
    return np.asarray(gaussian_filter(picked.astype(np.float64), blur))[..., None]


def test_iris() -> None:
    dark, bright = iris_photos((1024, 768), 60)
    assert dark.projector.mean() == pytest.approx(0.05, abs=0.002)
    assert bright.projector.mean() == pytest.approx(0.95, abs=0.002)
    first = photo(card() * seen(dark.projector[0]), 1)
    for change, verdict in ((0.0, Verdict.GOOD), (0.015, Verdict.DOUBTFUL)):
        second = photo(card() * seen(bright.projector[0]) * (1.0 + change), 2)
        iris = iris_of(first, second)
        assert iris.change == pytest.approx(change, abs=4 * iris.sigma + 1e-4)
        assert iris.sigma < 0.002
        assert iris.figures()[0].verdict == verdict
    with pytest.raises(CalibrationError, match="automatic iris"):
        iris_of(first, photo(card() * seen(bright.projector[0]) * 0.9, 3))
    with pytest.raises(CalibrationError, match="no white patch"):
        iris_of(photo(card()), photo(card()))


# --- glare ----------------------------------------------------------------------------------------

PLAN = LightPlan()
MASK = Share(1 / 500, 1e-5, (1 / 500,) * 3)


def glared(share: float, blur: float = 1.5, seed: int = 0) -> Glare:
    shown = glare_photo((400, 300), PLAN)
    open_ = seen(shown.mask[0], blur)
    passed = MASK.value + (1.0 - MASK.value) * open_ + share
    return glare_of(photo(card(), seed), photo(card() * passed, seed + 1), MASK, 0.05)


def test_glare_is_what_closed_cells_have_beyond_their_leak() -> None:
    for share, blur in ((0.0, 1.5), (0.004, 1.5), (0.001, 4.0)):
        glare = glared(share, blur)
        assert glare.share == pytest.approx(share, abs=4 * glare.sigma)
        assert glare.sigma < 2e-4
    assert glared(0.03).figures()[0].verdict == Verdict.BAD
    shown = glare_photo((400, 300), PLAN)
    assert shown.mask.shape == (1, 300, 400)
    assert bool(shown.mask[0, 0, 0]) != bool(shown.mask[0, 0, CELL_PX])


def test_glare_needs_its_pattern() -> None:
    with pytest.raises(CalibrationError, match="does not show a chequered pattern"):
        glare_of(photo(card()), photo(card()), MASK)
    with pytest.raises(CalibrationError, match="out of focus"):
        glared(0.0, blur=16.0)
