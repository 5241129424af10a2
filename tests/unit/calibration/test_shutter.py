"""When a shutter opened and closed, out of photos of a running bar."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import PanelSequence
from pdcd.calibration.shutter.bars import make_bar_sequence, read_bar
from pdcd.calibration.shutter.blades import (
    ShutterTimes,
    choose_bar_cells,
    estimate_shutter_lag,
    fit_shutter,
)
from pdcd.errors import CalibrationError
from pdcd.panels.frames import FrameLog
from pdcd.panels.map import Map
from tests.frame_logs import make_log

T = 1.0 / 60.0
TAUS = (0.0015, 0.003)
SIZE = (256, 192)
PROJECTOR, MASK, CAMERA = Map.filling(SIZE), Map.filling((320, 240)), Map.filling((128, 96))
START_S = 5.0
STEP_S = 2e-5


def log(count: int) -> FrameLog:
    return make_log(count, start_ns=round(1e9 * START_S))


@dataclass
class Camera:
    """A card under a bar, the light summed up in small steps between two times of each row.

    travel_s : by how much later the last row of the frame opens, and closes.
    glow : light of the room while it is open, over white in the middle of the field; the white of
        the projector is less by `falls` at its left and right ends.
    """

    opened_s: float
    closed_s: float
    travel_s: tuple[float, float] = (0.0, 0.0)
    electrons: float = 20000.0
    stray: float = 0.0
    flat: float = 5e-4
    seed: int = 1
    glow: float = 0.0
    falls: float = 0.0

    def photo(self, shown: PanelSequence) -> QuadPhoto:
        """Camera pixels are two by two of the projector: no maps are needed."""
        lit = self._asked(shown)  # (refreshes, rows, columns) of projector pixels, every second
        per = round(T / STEP_S)
        decay = [np.exp(-T / per / tau) for tau in TAUS]
        told = np.ascontiguousarray(np.packbits(lit.reshape(len(lit), -1) > 0.0, axis=0).T)
        words = told.view(np.dtype((np.void, told.shape[1]))).ravel()
        _, first, where = np.unique(words, return_index=True, return_inverse=True)
        columns = lit.reshape(len(lit), -1)[:, first]
        state, light = np.zeros(columns.shape[1]), []
        for asked in columns:
            up = asked > state
            fade = np.where(up, decay[0], decay[1])
            steps = fade[:, None] ** np.arange(per)
            light.append(asked[:, None] + (state - asked)[:, None] * steps)
            state = asked + (state - asked) * fade**per
        given = np.concatenate(
            [np.zeros((columns.shape[1], 1)), np.cumsum(np.concatenate(light, 1), 1)], 1
        )
        given *= T / per
        at = np.arange(given.shape[1]) * T / per + START_S
        pixel = where.reshape(lit.shape[1:])
        out = np.empty(pixel.shape)
        between = np.array([self.opened_s, self.closed_s])
        parts = np.linspace(0.0, 1.0, len(out)) if any(self.travel_s) else np.zeros(1)
        for y, part in enumerate(parts):
            edges = between + np.array(self.travel_s) * part
            both = np.array([np.interp(edges, at, g) for g in given])
            rows = slice(y, y + 1) if parts.size > 1 else slice(None)
            out[rows] = (both[:, 1] - both[:, 0])[pixel[rows]]
        return self.taken(out, self.closed_s - self.opened_s)

    def white(self, seconds: float = 0.4) -> QuadPhoto:
        lit = np.full(CAMERA.size_px[::-1], seconds)
        return replace(self, seed=self.seed + 1000).taken(lit, seconds)

    def room(self, seconds: float = 0.4) -> QuadPhoto:
        return replace(self, seed=self.seed + 2000).taken(np.zeros(CAMERA.size_px[::-1]), seconds)

    def taken(self, seconds: NDArray[np.float64], open_s: float) -> QuadPhoto:
        rng = np.random.default_rng(self.seed)
        patches = 1.0 + self.flat * rng.standard_normal((1, 32)).repeat(4, axis=1)
        shade = 1.0 - self.falls * np.linspace(-1.0, 1.0, seconds.shape[1]) ** 2
        there = seconds * shade * patches + self.glow * open_s + self.stray
        light = self.electrons * there[..., None] * np.ones(3)
        variance = (light + 17.0**2) / np.array([1.0, 2.0, 1.0])
        noisy = light + np.sqrt(variance) * rng.standard_normal(light.shape)
        return QuadPhoto(noisy, variance, (noisy > 16000.0).any(axis=-1))

    def _asked(self, shown: PanelSequence) -> NDArray[np.float64]:
        height, width = SIZE[1], SIZE[0]
        pictures = np.concatenate([
            shown.projector.reshape(-1, height, width),
            np.ones((1, height, width), np.bool_), np.zeros((1, height, width), np.bool_),
        ])  # fmt: skip
        return pictures[shown.projector_index][:, ::2, ::2].astype(np.float64)


BAR = make_bar_sequence("bar", PROJECTOR, 90)


def fitted(camera: Camera, shown: PanelSequence = BAR, *, bands: int = 1) -> ShutterTimes:
    light = read_bar(camera.photo(shown), camera.white(), CAMERA, bands=bands)
    return fit_shutter(light, log(shown.refreshes), (5.2, 5.7), TAUS)


def test_opening_and_closing_are_found() -> None:
    camera = Camera(5.26187, 5.68321, stray=0.001)
    got = fitted(camera)
    assert got.opened_s == pytest.approx(camera.opened_s, abs=0.15e-3)
    assert got.closed_s == pytest.approx(camera.closed_s, abs=0.15e-3)
    assert got.opened_sigma_s < 0.15e-3


@pytest.mark.parametrize("glow", [0.02, 0.05, 0.1])
def test_light_of_the_room_moves_neither(glow: float) -> None:
    """Even light over a projector that is a third darker at its ends."""
    camera = Camera(5.26187, 5.68321, glow=glow, falls=0.35)
    light = read_bar(camera.photo(BAR), camera.white(), CAMERA, room=camera.room())
    got = fit_shutter(light, log(BAR.refreshes), (5.2, 5.7), TAUS)
    assert got.opened_s == pytest.approx(camera.opened_s, abs=0.15e-3)
    assert got.closed_s == pytest.approx(camera.closed_s, abs=0.15e-3)
    assert got.chi2 < 2.0
    blind = read_bar(camera.photo(BAR), camera.white(), CAMERA)
    with pytest.raises(CalibrationError, match="no times of opening and closing explain the bar"):
        fit_shutter(blind, log(BAR.refreshes), (5.2, 5.7), TAUS)


@pytest.mark.long
def test_sigmas_are_honest() -> None:
    rows = []
    rng = np.random.default_rng(5)
    base = Camera(5.3, 5.7)
    for seed in range(4):
        opened, closed = 5.3 + rng.uniform(0, T), 5.7 + rng.uniform(0, T)
        camera = replace(base, opened_s=opened, closed_s=closed, seed=seed, electrons=4000.0)
        got = fitted(camera)
        rows += [
            (got.opened_s - opened) / got.opened_sigma_s,
            (got.closed_s - closed) / got.closed_sigma_s,
        ]
    assert 0.4 < np.sqrt(np.mean(np.square(rows))) < 1.8


def test_blades_that_take_their_time() -> None:
    camera = Camera(5.2601, 5.6903, travel_s=(0.0027, 0.0031))
    got = fitted(camera, bands=6)
    assert got.travel_s == pytest.approx(camera.travel_s, abs=0.3e-3)
    assert got.opened_s == pytest.approx(camera.opened_s + 0.00135, abs=0.15e-3)
    assert fitted(camera).travel_s == (0.0, 0.0)


@pytest.mark.parametrize("bands", [2, 3, 4])
@pytest.mark.parametrize("opened_s", [5.2601, 5.2645, 5.2689, 5.2730])
def test_few_bands_over_a_projector_that_is_set_row_by_row(bands: int, opened_s: float) -> None:
    """Its last row is a refresh late: the rows of a band see the shutter move at other times."""
    camera = Camera(opened_s, 5.6903, travel_s=(-0.0155, -0.0155))
    got = fitted(camera, bands=bands)
    assert got.chi2 < 2.5
    assert got.opened_s == pytest.approx(camera.opened_s - 0.00775, abs=0.15e-3)
    assert got.closed_s == pytest.approx(camera.closed_s - 0.00775, abs=0.15e-3)
    assert got.travel_s == pytest.approx(camera.travel_s, abs=0.5e-3)


def test_lag_and_jitter_of_several_exposures() -> None:
    rng = np.random.default_rng(4)
    late = rng.normal(0.0117, 0.0008, 200)
    commanded = np.arange(200.0)
    measured = commanded + late + rng.normal(0.0, 0.0002, 200)
    got = estimate_shutter_lag(measured.tolist(), commanded.tolist(), [0.0002] * 200)
    assert got.lag_s == pytest.approx(0.0117, abs=3.0 * got.sigma_s)
    assert got.jitter_s == pytest.approx(0.0008, rel=0.15)
    assert estimate_shutter_lag([0.01, 1.01], [0.0, 1.0], [1e-4, 1e-4]).jitter_s == 0.0


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ({"electrons": 0.01}, "dark where the bar runs"),
        ({"electrons": 1e6}, "saturated"),
        ({"stray": 20.0, "electrons": 500.0}, "all cells are equally bright"),
        ({"opened_s": 4.98}, "opened while the bar did not run"),
        ({"flat": 0.2}, "no times of opening and closing explain"),
    ],
)
def test_bad_photos_end_in_a_named_cause(fault: dict[str, float], told: str) -> None:
    camera = replace(Camera(5.26, 5.69), **fault)  # type: ignore[arg-type]
    with pytest.raises(CalibrationError, match=told) as caught:
        light = read_bar(camera.photo(BAR), camera.white(), CAMERA)
        fit_shutter(light, log(90), (5.05, 5.7), TAUS)
    assert caught.value.hint


@pytest.mark.parametrize("refreshes", [31.2, 32.0, 33.5])
def test_an_exposure_of_whole_cycles_is_refused(refreshes: float) -> None:
    """It opens and closes in the same cells; there are better numbers of them."""
    camera = Camera(5.2631, 5.2631 + refreshes * T)
    with pytest.raises(CalibrationError, match=r"cycles of the bar|equally bright"):
        fitted(camera)
    cells = choose_bar_cells(refreshes * T, T)
    assert abs(refreshes - round(refreshes / cells) * cells) > 7.0


def test_a_card_that_covers_half_the_field_is_refused() -> None:
    camera = Camera(5.26, 5.69)
    half = Map.filling((128, 96)).then(np.diag([0.5, 1.0, 1.0]))
    with pytest.raises(CalibrationError, match="cells of the bar are not seen"):
        read_bar(camera.photo(BAR), camera.white(), half)


def test_a_camera_turned_by_a_quarter_sees_the_bar_in_one_band() -> None:
    camera = Camera(5.26187, 5.68321)
    width, height = CAMERA.size_px
    turned = (0.0, 1.0 / width, 0.0, 1.0 / height, 0.0, 0.0, 0.0, 0.0, 1.0)
    photo, white = (
        QuadPhoto(one.light.swapaxes(0, 1), one.variance.swapaxes(0, 1))
        for one in (camera.photo(BAR), camera.white())
    )
    light = read_bar(photo, white, Map(size_px=(height, width), homography=turned), bands=3)
    assert light.value.shape == (1, 32)
    got = fit_shutter(light, log(BAR.refreshes), (5.2, 5.7), TAUS)
    assert got.opened_s == pytest.approx(camera.opened_s, abs=0.2e-3)
    assert got.closed_s == pytest.approx(camera.closed_s, abs=0.2e-3)
