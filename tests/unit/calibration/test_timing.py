"""Lag, rise and fall out of photos of strips, on a bench that is followed step by step in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pdcd.calibration.figures import Verdict
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.shown import PanelSequence
from pdcd.calibration.timing.lag import MeasuredTiming, find_coarse_delay, fit_lag_line, fit_timing
from pdcd.calibration.timing.programmes import (
    COARSE,
    PulseStrips,
    make_pulse_strips,
    make_room_sequence,
    make_strip_sequence,
)
from pdcd.calibration.timing.strips import StripReadings, read_strips
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, to_map_matrix
from pdcd.panels.schedule import SLOTS
from pdcd.probing.pulses import PanelResponse, compute_code_separation
from tests.unit.calibration.pulsed_bench import REFRESH_S, Bench, TruePanel

pytestmark = pytest.mark.whole

PROJECTOR = Map.filling((256, 192))
MASK = Map.filling((320, 240))
CAMERA = Map.filling((192, 128))
PERIODS = 6
PROJECTOR_S, MASK_S = (0.002, 0.003), (0.004, 0.008)

MIRROR = [[-1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
UPSIDE_DOWN = [[-1.0, 0.0, 1.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]]


def turned(size: tuple[int, int], degrees: float, keystone: float) -> Map:
    """A map that fills the field and more, turned and keystoned."""
    width, height = size
    angle = np.radians(degrees)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    to_unit = np.array(
        [[1.1 / width, 0, -0.55], [0, 1.1 / height, -0.55], [0, keystone / height, 1]]
    )
    back = np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return Map(size_px=size, homography=to_map_matrix(back @ turn @ to_unit))


def bench(**more: object) -> Bench:
    given: dict[str, object] = {
        "projector_map": PROJECTOR,
        "mask_map": MASK,
        "camera": CAMERA,
        "projector": TruePanel(*PROJECTOR_S, leak=0.0005),
        "mask": TruePanel(*MASK_S, leak=0.002),
        "skew_s": 0.004,
    }
    return Bench(**{**given, **more})  # type: ignore[arg-type]


def shown(strips: PulseStrips, *, white: bool = False, periods: int = PERIODS) -> PanelSequence:
    return make_strip_sequence("strips", strips, PROJECTOR, MASK, white=white, periods=periods)


def photos(
    on: Bench, strips: PulseStrips, seed: int = 0, periods: int = PERIODS
) -> tuple[QuadPhoto, QuadPhoto]:
    first, second = (
        on.photo(shown(strips, white=white, periods=periods), 2 * seed + white)
        for white in (False, True)
    )
    return first, second


def read(on: Bench, strips: PulseStrips, *, bands: int = 3, seed: int = 0) -> StripReadings:
    return read_strips(*photos(on, strips, seed), CAMERA, strips, bands=bands)


def found(on: Bench, *, bands: int = 3, seed: int = 0) -> MeasuredTiming:
    strips = make_pulse_strips(PROJECTOR)
    reading = read(on, strips, bands=bands, seed=seed)
    return fit_timing([reading], [on.log(shown(strips))], REFRESH_S)


def leaks(on: Bench, lag_s: float) -> dict[str, float]:
    light, opening = (
        PanelResponse(p.rise_s, p.fall_s, p.tail, p.slower) for p in (on.projector, on.mask)
    )
    return {
        name: compute_code_separation(name, light, opening, lag_s, REFRESH_S).leak for name in SLOTS
    }


def test_a_line_goes_through_its_bands_whatever_they_have_in_common() -> None:
    """Bands that are set in steps lie on no line by much more than what tells them apart, and share
    an error that is larger still."""
    bands = (np.arange(6, dtype=np.float64) + 0.5) / 6.0
    lag_s = 5e-3 + 0.7e-3 * bands + 0.06e-3 * np.array([-1, 1, 0.2, -0.4, 0.5, -0.3])
    common = np.outer(1.0 + 0.1 * bands, 1.0 + 0.1 * bands)
    covariance = (1.8e-3) ** 2 * common + np.eye(6) * (2e-6) ** 2
    (first, slope), spread = fit_lag_line(bands, lag_s, covariance)
    assert np.abs(first + slope * bands - lag_s).max() < 0.1e-3
    assert np.sqrt(spread[0, 0]) == pytest.approx(1.8e-3, rel=0.01)


def test_a_lag_that_grows_down_the_field_is_that_of_the_rows_that_a_band_has() -> None:
    """Of a camera that is turned a band has half a row of quads more in some strips than in others:
    where panels are set in opposite directions that is some 0.1 ms."""
    camera = turned((192, 128), 2.0, 0.02)
    on = bench(scan_s=-0.03, skew_s=0.02, camera=camera)
    strips = make_pulse_strips(PROJECTOR)
    reading = read_strips(*photos(on, strips), camera, strips, bands=5)
    timing = fit_timing([reading], [on.log(shown(strips))], REFRESH_S)
    assert timing.chi2 < 2.0
    assert timing.line_s == pytest.approx((on.skew_s, on.scan_s), abs=1e-4)


def test_lag_rise_and_fall_are_found() -> None:
    on = bench(scan_s=0.0011, apart_s=0.0013, slip_s=0.0002, ambient=0.003, stray=0.004)
    timing = found(on)
    lag = on.skew_s + on.scan_s * timing.bands
    np.testing.assert_allclose(timing.lag_s, lag, rtol=0, atol=0.15e-3)
    np.testing.assert_allclose(timing.taus_s, (*PROJECTOR_S, *MASK_S), rtol=0.06)
    assert timing.line_s == pytest.approx((on.skew_s, on.scan_s), abs=2e-4)
    assert timing.chi2 < 2.0
    assert timing.tail is None
    assert timing.delay_refreshes == 0
    for band, late in zip(timing.lag_s, lag, strict=True):
        want = leaks(on, float(late) + 0.0014)  # of the log: apart, and half the slip
        for name in SLOTS:
            kept = timing.kept(name, timing.apart_s + float(band))
            # A schedule that cannot bear this lag leaks more than it shows, and steeply so.
            near = 2e-3 if want[name] < 0.5 else 1e-2
            assert kept.leak == pytest.approx(want[name], abs=near)
    assert {figure.verdict for figure in timing.figures()} == {Verdict.GOOD}


def found_beside_room_light(on: Bench, *, looked: bool = True) -> MeasuredTiming:
    """Of four photos, with a look at the room's light or without one."""
    readings, ran = [], []
    for number in range(4):
        strips = make_pulse_strips(PROJECTOR, number)
        photo, white = photos(on, strips, seed=number)
        lit = shown(strips, white=True)
        room = on.photo(make_room_sequence(lit), 99) if looked else None
        readings.append(read_strips(photo, white, CAMERA, strips, bands=3, room=room))
        ran.append(on.log(lit))
    return fit_timing(readings, ran, REFRESH_S)


@pytest.mark.parametrize("share", [0.02, 0.05, 0.1])
def test_light_of_the_room_over_a_projector_that_falls_off(share: float) -> None:
    """Its share is not one number: it is half as much again at the ends of the field."""
    on = bench(ambient=share, falls=0.35, stray=0.003, flat=1e-4)  # some of it past the mask
    timing = found_beside_room_light(on)
    np.testing.assert_allclose(timing.lag_s, on.skew_s, rtol=0, atol=0.05e-3)
    np.testing.assert_allclose(timing.taus_s, (*PROJECTOR_S, *MASK_S), rtol=0.02)
    assert timing.chi2 < 2.0
    middle = share / (1.0 - 0.35 * 0.25)  # half-way to the ends: the median of all places
    assert timing.room == pytest.approx(middle + 0.0005 + 0.003, rel=0.05)
    figures = {figure.name: figure for figure in timing.figures()}
    assert figures["timing.room"].verdict is (Verdict.DOUBTFUL if share > 0.07 else Verdict.GOOD)


def test_light_of_the_room_that_nobody_looked_at_is_told_by_what_it_leaves() -> None:
    """It goes with the place on the card, not with what strips were asked for."""
    with pytest.raises(CalibrationError, match="no rise, fall and lag explain") as caught:
        found_beside_room_light(bench(ambient=0.05, falls=0.35, flat=1e-4), looked=False)
    assert str(caught.value.hint).startswith("nothing may move between the photos")


def test_too_much_light_of_the_room_has_its_name_and_number() -> None:
    with pytest.raises(CalibrationError, match=r"room light is 25 % of white: darken the room"):
        found_beside_room_light(bench(ambient=0.24, falls=0.1))


def test_panels_that_scan_against_each_other() -> None:
    on = bench(skew_s=0.0155, scan_s=-0.0317)
    timing = found(on, bands=8)
    lag = on.skew_s + on.scan_s * timing.bands
    np.testing.assert_allclose(timing.lag_s, lag, rtol=0, atol=0.15e-3)
    np.testing.assert_allclose(timing.taus_s, (*PROJECTOR_S, *MASK_S), rtol=0.06)
    assert timing.panel_words(MASK) == pytest.approx((-0.0162 + 0.0000, -0.0317), abs=3e-4)
    skew_s, scan_s = timing.panel_words(MASK.then(UPSIDE_DOWN))
    assert (skew_s, scan_s) == pytest.approx((-0.0162, 0.0317), abs=3e-4)


def test_panels_that_are_turned_against_the_field() -> None:
    """The rows of a mask that hangs askew come later on one side. A fit with one lag a row takes
    that for a slower projector, whatever photos it has."""
    on = bench(skew_s=0.0095, scan_s=-0.0004, across_s=-0.0005, flat=0.0, electrons=1e6)
    timing = found(on)
    assert timing.across_s == pytest.approx(-0.0005, abs=1e-5)
    lag = on.skew_s + on.scan_s * timing.bands
    np.testing.assert_allclose(timing.lag_s, lag, rtol=0, atol=0.1e-3)
    np.testing.assert_allclose(timing.taus_s, (*PROJECTOR_S, *MASK_S), rtol=0.06)
    assert timing.chi2 < 0.2


@pytest.mark.parametrize("lag", [0.3, 7.2, -10.7])
def test_a_mask_that_is_many_refreshes_late(lag: float) -> None:
    on = bench(skew_s=lag * REFRESH_S)
    strips = make_pulse_strips(PROJECTOR, programmes=tuple(COARSE))
    reading = read_strips(*photos(on, strips, periods=2), CAMERA, strips, bands=2)
    assert abs(find_coarse_delay(reading) + lag) < 0.8  # the rest is found by the finer strips


def test_an_answer_of_two_times_is_told_and_its_leak_is_right() -> None:
    on = bench(mask=TruePanel(*MASK_S, leak=0.002, tail=0.07, slower=4.0))
    timing = found(on, bands=2)
    assert timing.tail is not None
    assert timing.tail.mask
    assert timing.tail.share == pytest.approx(0.07, abs=0.02)
    want = leaks(on, on.skew_s)
    for name in ("both", "lag", "full"):
        leak = max(timing.kept(name, timing.apart_s + float(lag)).leak for lag in timing.lag_s)
        assert leak == pytest.approx(want[name], abs=2e-3)
    assert max(f.verdict for f in timing.figures()) is Verdict.DOUBTFUL


def test_the_sigma_of_readings_is_that_of_noise() -> None:
    strips = make_pulse_strips(PROJECTOR)
    clean = read(bench(flat=0.0, electrons=1e12), strips)
    noisy = read(bench(flat=0.0), strips)
    off = (noisy.value - clean.value) / noisy.sigma
    assert 0.8 < np.sqrt(np.mean(off**2)) < 1.2


@pytest.mark.long
def test_sigmas_of_lag_and_times_are_honest() -> None:
    """Of a flat field that is off by as much in all bands of a strip, and of noise."""
    on, strips = bench(scan_s=0.001, flat=0.0, electrons=1e12), make_pulse_strips(PROJECTOR)
    clean = read(on, strips, bands=2)
    log = on.log(shown(strips))
    want = np.array([*(on.skew_s + on.scan_s * clean.bands), *PROJECTOR_S, *MASK_S])
    rows, slopes = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        noise = 2e-4 * np.sqrt(clean.value)
        value = clean.value * (1.0 + 5e-4 * rng.standard_normal(24))
        value = value + noise * rng.standard_normal(value.shape)
        timing = fit_timing([replace(clean, value=value, sigma=noise)], [log], REFRESH_S)
        got = np.concatenate([timing.lag_s, timing.taus_s])
        rows.append((got - want) / np.concatenate([timing.lag_sigma_s, timing.taus_sigma_s]))
        slope_sigma = float(np.sqrt(timing.line_covariance[1, 1]))
        slopes.append((timing.line_s[1] - on.scan_s) / slope_sigma)
    assert 0.5 < np.sqrt(np.mean(np.square(rows))) < 1.6
    # What is allowed for panels that are not quite exponential makes slopes look less sure.
    assert 0.2 < np.sqrt(np.mean(np.square(slopes))) < 1.6


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ({"electrons": 0.05}, "dark"),
        ({"covered": 0.5}, "have no light in the white photo"),
        ({"stray": 0.4}, "black strips have"),
        ({"full": 9000.0}, "saturated"),
        ({"blur": 8.0}, "gaps between the strips"),
        ({"mask_stays_open": True}, "no strip pulses"),
        ({"mask": TruePanel(0.1, 0.1)}, "mask.rise_s is 60 ms or more"),
        ({"mask_map": MASK.then(MIRROR)}, "run geometry"),
    ],
)
def test_bad_photos_end_in_a_named_cause(fault: dict[str, object], told: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        found(bench(**fault), bands=2)
    assert told in f"{caught.value}: {caught.value.hint}" and caught.value.hint


def test_a_projector_with_too_few_pixels_has_no_strips() -> None:
    with pytest.raises(CalibrationError, match="px wide"):
        make_pulse_strips(Map.filling((100, 80)))


def test_strips_of_both_panels_lie_on_each_other_wherever_the_panels_are() -> None:
    projector, mask = turned((256, 192), 2.0, 0.05), turned((320, 240), 183.0, -0.08)
    strips = make_pulse_strips(projector)
    pulses, white = (
        make_strip_sequence("strips", strips, projector, mask, white=white)
        for white in (False, True)
    )
    assert pulses.refreshes == white.refreshes
    rng = np.random.default_rng(2)
    field = rng.uniform(0.01, 0.99, (4000, 2))
    for map_, patterns, full, side in (
        (projector, pulses.projector, white.projector, 0),
        (mask, pulses.mask, white.mask, 1),
    ):
        pixel = np.floor(map_.from_field(field)).astype(int)
        inner = np.abs(field[:, 0] * 24 % 1.0 - 0.5) < 0.15
        strip = (field[:, 0] * 24).astype(int)
        for at in range(6):
            on = np.array([programme.on[side][at] for programme in strips.programmes])
            np.testing.assert_array_equal(
                patterns[at][pixel[:, 1], pixel[:, 0]][inner], on[strip][inner]
            )
        assert full[0][pixel[:, 1], pixel[:, 0]][inner].all()
    edge = np.abs(field[:, 0] * 24 - np.rint(field[:, 0] * 24)) < 0.05
    pixel = np.floor(mask.from_field(field[edge])).astype(int)
    assert not white.mask[0][pixel[:, 1], pixel[:, 0]].any()


def test_a_lag_that_no_line_follows_is_doubtful() -> None:
    timing = found(bench(scan_s=0.0011))
    for bent_s, verdict in ((0.1e-3, Verdict.GOOD), (0.25e-3, Verdict.DOUBTFUL)):
        bent = replace(timing, lag_s=timing.lag_s + bent_s * np.array([0.0, 1.0, 0.0]))
        assert bent.beside_s == pytest.approx(bent_s, abs=0.03e-3)
        (scan,) = (figure for figure in bent.figures() if figure.name == "mask.scan_s")
        assert scan.verdict == verdict
