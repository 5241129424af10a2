"""The check before a session: what it must find, and that it cries no wolf."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.check.changes import Checked, Dots, Look, check, closed_share, parts_of
from pdcd.calibration.figures import Verdict
from pdcd.calibration.timing.skew_change import skew_change
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, between

Floats = NDArray[np.float64]

PROJECTOR_PX, MASK_PX, FRAME = (1024, 768), (1600, 1200), (2136, 1424)
T_S = 1.0 / 60.0
GUARD_PX = 4.0
DOT_PX = 0.03
"""Noise of a dot, in projector pixels."""
PX_QUADS = 1.8
"""Quads along a projector pixel, about."""
EPS = 1.0 / 500.0
ANSWER = (4e-3, 2e-3, 3e-3, 6e-3)
"""Rise and fall of projector and mask."""


def turned(degrees: float, right_px: float = 0.0, down_px: float = 0.0) -> Floats:
    """A turn about the middle of the field, and a shift, in projector pixels, from field to
    field."""
    width, height = PROJECTOR_PX
    to_px = np.array([[width, 0.0, -0.5 * width], [0.0, height, -0.5 * height], [0.0, 0.0, 1.0]])
    angle = np.radians(degrees)
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, right_px], [sin, cos, down_px], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.inv(to_px) @ turn @ to_px)


def strips(skews_s: Floats, answer: tuple[float, float, float, float] = ANSWER) -> Floats:
    """Light of 18 pulse programmes over white, panels followed through time in small steps.

    1x1, 2x1 and 1x2 refreshes of 6, the mask's late by -3..2 refreshes; a row for each skew.
    """
    steps, n = 40, 6
    time = (np.arange(n * steps) + 0.5) / steps
    rise_p, fall_p, rise_m, fall_m = (np.exp(-T_S / steps / tau) for tau in answer)
    found = []
    for lit, opened in ((1, 1), (2, 1), (1, 2)):
        light = _follow((time < lit)[:, None], rise_p, fall_p)
        for late in range(-3, 3):
            ask_m = np.mod(time[:, None] - late - skews_s / T_S, n) < opened
            found.append(np.mean(light * _follow(ask_m, rise_m, fall_m), axis=0))
    return np.stack(found, axis=-1)


def _follow(asked: NDArray[np.bool_], rise: float, fall: float) -> Floats:
    level, shown = np.zeros(asked.shape[1]), np.zeros(asked.shape)
    for turn in range(2):  # the second time round it has forgotten how it began
        for index, on in enumerate(asked):
            level = np.where(on, 1.0 - (1.0 - level) * rise, level * fall)
            if turn:
                shown[index] = level
    return shown


GRID_S: Floats = np.arange(-30.0, 61.0) * (T_S / 20.0)
TRUE = strips(GRID_S)
# What the program knows of the panels is some per cent wrong.
KNOWN = strips(GRID_S, (4.15e-3, 1.9e-3, 2.9e-3, 6.2e-3))


def between_lags(table: Floats, skew_s: float) -> Floats:
    at = float(np.clip((skew_s - GRID_S[0]) / (GRID_S[1] - GRID_S[0]), 0.0, GRID_S.size - 1.001))
    first = int(at)
    return np.asarray(table[first] + (at - first) * (table[first + 1] - table[first]))


def dots_of(size_px: tuple[int, int], pitch: int) -> NDArray[np.int64]:
    """Row and column of each dot of a panel."""
    col, row = np.meshgrid(*(np.arange(1, side // pitch) for side in size_px))
    return np.stack([row.ravel(), col.ravel()], axis=-1)


@cache
def seen_dots(panel: Map, camera: Map, pitch: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Where the camera sees them, and which it sees."""
    quads = between(panel, camera, dots_of(panel.size_px, pitch)[:, ::-1] * float(pitch))
    good = ((quads > 20.0) & (quads < np.array(FRAME) - 20.0)).all(axis=-1)
    return quads, np.asarray(good)


@dataclass(frozen=True)
class Bench:
    """A bench as it is. lamp : its light. skew_s : of the mask. eps : black over white."""

    camera: Map
    mask: Map
    lamp: float = 1.0
    skew_s: float = 2e-3
    eps: float = EPS
    iso: str = "100"

    def look(self, seed: int, then: Floats | None = None) -> tuple[Look, Floats]:
        """What the photos of a check say of it, with full noise; and its strips."""
        rng = np.random.default_rng(seed)
        projector = Map.filling(PROJECTOR_PX)
        sets = []
        for panel, pitch in ((projector, 32), (self.mask, 40)):
            index = dots_of(panel.size_px, pitch)
            quads, good = seen_dots(panel, self.camera, pitch)
            quads = quads[good] + rng.normal(0.0, DOT_PX * PX_QUADS, (good.sum(), 2))
            # A few lie on edges of the scene.
            off = rng.random(len(quads)) < 0.02
            quads[off] += rng.normal(0.0, 0.8 * PX_QUADS, (off.sum(), 2))
            sets.append(Dots(index[good], quads, np.full(len(quads), DOT_PX * PX_QUADS)))
        fields = np.linspace(1.0, 0.7, 16) * np.linspace(0.8, 1.0, 12)[:, None]
        white = 2e4 * self.lamp * fields * (1.0 + 2e-3 * rng.normal(size=fields.shape))
        white *= 1.0 + 4e-3 * rng.normal()  # the lamp is not that steady
        seen = between_lags(TRUE, self.skew_s)
        sigma = np.hypot(5e-4 * seen, 1e-4)
        seen = (1.0 + 4e-3 * rng.normal()) * (seen + rng.normal(size=seen.size) * sigma)
        lag = (0.0, 0.0)
        if then is not None:
            lag = skew_change(
                seen, then, np.sqrt(2.0) * sigma, lambda s: between_lags(KNOWN, s), 2e-3, T_S
            )
        closed = self.eps * (1.0 + 0.01 * rng.normal())
        settings = {"camera": "450D 0123", "iso": self.iso, "f_number": "4"}
        return Look(sets[0], sets[1], white, (closed, 0.01 * EPS), lag, settings), seen


def a_bench(seed: int = 0) -> Bench:
    rng = np.random.default_rng(seed)
    camera = Map.filling(FRAME).then(turned(0.7)).then(np.diag([1.05, 1.05, 1.0]))
    camera = msgspec.structs.replace(camera, radial=(0.03, 0.0))
    mask = Map.filling(MASK_PX).then(turned(-0.4, *rng.uniform(-3.0, 3.0, 2)))
    return Bench(camera, mask)


BENCH = a_bench()
THEN, STRIPS = BENCH.look(1)


def checked(bench: Bench, seed: int = 2) -> Checked:
    now, _ = bench.look(seed, STRIPS)
    return check(now, THEN, BENCH.camera, Map.filling(PROJECTOR_PX), GUARD_PX, T_S)


def verdicts(found: Checked) -> dict[str, Verdict]:
    return {f.figure.name: f.figure.verdict for f in found.findings if f.figure.verdict}


@pytest.mark.long
def test_a_hundred_unchanged_benches_raise_no_alarm() -> None:
    worst = {"mask.place": 0.0, "camera.place": 0.0, "mask.skew_s": 0.0}
    for seed in range(100):
        found = checked(BENCH, 100 + seed)
        assert found.verdict is Verdict.GOOD, verdicts(found)
        for finding in found.findings:
            if finding.figure.name in worst:
                here = abs(finding.figure.value)
                worst[finding.figure.name] = max(worst[finding.figure.name], here)
            assert finding.advice == ""
    # Well below the limits, not by luck.
    assert worst["mask.place"] < 0.05
    assert worst["camera.place"] < 0.05
    assert worst["mask.skew_s"] < 0.06e-3


def moved(bench: Bench, right_mask_px: float) -> Bench:
    return replace(bench, mask=bench.mask.then(turned(0.0, right_mask_px * 1024 / 1600)))


def off_by(bench: Bench, degrees: float) -> Bench:
    through = np.sin(np.radians(degrees)) ** 2
    return replace(bench, eps=EPS + through, lamp=bench.lamp * (1.0 - through))


def bumped(bench: Bench, quads: float) -> Bench:
    shift = turned(0.02, quads / PX_QUADS, -0.5 * quads / PX_QUADS)
    return replace(bench, camera=bench.camera.then(shift))


BAD, REFIT = Verdict.BAD, Verdict.DOUBTFUL


@pytest.mark.parametrize(
    ("change", "expected", "said"),
    [
        (lambda b: moved(b, 1.0), {"mask.place": REFIT}, "the mask moved"),
        (lambda b: moved(b, 3.0), {"mask.place": BAD}, "the mask moved"),
        (
            lambda b: replace(b, mask=b.mask.then(turned(0.1))),
            {"mask.place": REFIT},
            "the mask moved",
        ),
        (lambda b: replace(b, lamp=0.9), {"lamp": REFIT}, "iris"),
        (lambda b: replace(b, lamp=0.7), {"lamp": BAD}, "iris"),
        (lambda b: off_by(b, 5.0), {"mask.contrast": BAD}, "polarisers"),
        (lambda b: replace(b, skew_s=3e-3), {"mask.skew_s": BAD}, "calibrate the timing"),
        (lambda b: replace(b, skew_s=2.3e-3), {"mask.skew_s": REFIT}, "calibrate the timing"),
        (
            lambda b: replace(b, skew_s=2e-3 + T_S),
            {"mask.skew_s": BAD},
            "+1 refresh(es) later",
        ),
        (lambda b: bumped(b, 2.0), {"camera.place": REFIT}, "the camera was bumped"),
        (
            lambda b: bumped(b, 6.5),
            {"camera.place": BAD, "mask.place": BAD},
            "the camera was bumped",
        ),
        (lambda b: replace(b, iso="200"), {"settings": BAD}, "iso is 200, was 100"),
    ],
)
def test_every_change_is_found_and_no_other(
    change: Callable[[Bench], Bench], expected: dict[str, Verdict], said: str
) -> None:
    found = checked(change(BENCH), 5)
    assert verdicts(found) == expected
    assert said in " ".join(finding.advice for finding in found.findings)


def test_a_moved_projector_is_told_from_a_moved_mask() -> None:
    # Its picture moves on the card; mask and camera stay where they were.
    shift = turned(0.0, 0.7)
    moved_projector = replace(BENCH, camera=BENCH.camera.then(shift), mask=BENCH.mask.then(shift))
    found = checked(moved_projector)
    assert verdicts(found) == {"mask.place": REFIT, "camera.place": REFIT}
    assert "the projector moved" in found.findings[0].advice


def test_what_a_refit_takes_is_right() -> None:
    found = checked(replace(moved(bumped(BENCH, 2.0), 1.0), lamp=0.95, skew_s=2.3e-3))
    corner = np.array([[0.0, 0.0], [1024.0, 768.0]])
    np.testing.assert_allclose(found.mask(corner) - corner, [[0.64, 0.0]] * 2, atol=0.02)
    np.testing.assert_allclose(found.mask.back(found.mask(corner)), corner, atol=1e-9)
    assert found.lamp == pytest.approx(0.95, abs=0.02)
    assert found.skew_s == pytest.approx(0.3e-3, abs=0.05e-3)
    # The refitted camera sees the projector's dots where they are now.
    middle = np.array([[1000.0, 700.0], [300.0, 300.0]])
    now = bumped(BENCH, 2.0).camera.from_field(BENCH.camera.to_field(middle))
    np.testing.assert_allclose(found.camera(middle), now, atol=0.15)


def test_what_no_similarity_explains_calls_for_a_new_calibration() -> None:
    bent = msgspec.structs.replace(BENCH.mask, radial=(0.003, 0.0))
    assert verdicts(checked(replace(BENCH, mask=bent)))["mask.place"] is BAD


@pytest.mark.long
def test_errors_of_a_movement_are_as_said() -> None:
    ratios = []
    for seed in range(30):
        found = checked(BENCH, 300 + seed)
        ratios.append(found.mask.shift / found.mask.sigma[0])
        ratios.append(found.camera.growth / found.camera.sigma[1])
    parts = np.concatenate([np.real(ratios), np.imag(ratios)])
    # The reference's own errors are in all of them.
    assert 0.5 < parts.std() < 1.4


def test_the_lags_error_is_as_said() -> None:
    ratios = []
    for seed in range(30):
        now, _ = BENCH.look(400 + seed, STRIPS)
        ratios.append(now.skew_s[0] / now.skew_s[1])
    assert 0.4 < np.std(ratios) < 1.4


@pytest.mark.parametrize("late_s", [-2.2 * T_S, -1e-3, 0.4 * T_S, 2.0 * T_S])
def test_any_change_of_lag_is_measured(late_s: float) -> None:
    def model(skew_s: float) -> Floats:
        return between_lags(KNOWN, skew_s)

    sigma = np.full(18, 2e-4)
    # The mask's programmes cover lags of three refreshes either way.
    found, _ = skew_change(model(T_S + late_s), model(T_S), sigma, model, T_S, T_S)
    assert found == pytest.approx(late_s, abs=0.05e-3)


def test_photos_that_say_nothing_are_refused() -> None:
    now, _ = BENCH.look(3, STRIPS)
    few = Dots(now.mask.index[:40], now.mask.quads[:40], now.mask.sigma[:40])
    bad = [
        (replace(now, white=0.01 * now.white), "next to no light"),
        (replace(now, saturated=0.2), "saturated"),
        (replace(now, mask=few), "dots of the mask"),
    ]
    for look, said in bad:
        with pytest.raises(CalibrationError, match=said):
            check(look, THEN, BENCH.camera, Map.filling(PROJECTOR_PX), GUARD_PX, T_S)
    unknown = (float("nan"), float("nan"))
    for nothing, figure in (
        (replace(now, closed=unknown), "mask.contrast"),
        (replace(now, skew_s=unknown), "mask.skew_s"),
    ):
        found = check(nothing, THEN, BENCH.camera, Map.filling(PROJECTOR_PX), GUARD_PX, T_S)
        assert verdicts(found) == {figure: BAD}
    shifted = replace(moved(BENCH, 1.0).look(3, STRIPS)[0], skew_s=unknown)
    found = check(shifted, THEN, BENCH.camera, Map.filling(PROJECTOR_PX), GUARD_PX, T_S)
    assert verdicts(found) == {"mask.place": REFIT, "mask.skew_s": REFIT}
    with pytest.raises(CalibrationError, match="strips are black"):
        skew_change(np.zeros(18), STRIPS, np.full(18, 1e-4), lambda s: STRIPS, 0.0, T_S)
    with pytest.raises(CalibrationError, match="no lag explains"):
        swapped = np.roll(STRIPS, 5)
        skew_change(swapped, STRIPS, np.full(18, 1e-4), lambda s: between_lags(KNOWN, s), 2e-3, T_S)


def test_another_scene_is_not_taken_for_a_lamp() -> None:
    now, _ = BENCH.look(3, STRIPS)
    rng = np.random.default_rng(0)
    other = replace(now, white=now.white * rng.uniform(0.4, 1.0, now.white.shape))
    found = check(other, THEN, BENCH.camera, Map.filling(PROJECTOR_PX), GUARD_PX, T_S)
    assert verdicts(found) == {"lamp": REFIT}
    assert "not the scene" in found.findings[3].advice


def test_light_through_the_closed_mask_is_measured_away_from_dots() -> None:
    rng = np.random.default_rng(0)
    white = np.full((90, 120), 2e4)
    white[:, :10] = 10.0  # beside the card
    dots = 0.002 * white
    places = np.array([[40.3, 30.2], [80.5, 60.9]])
    x, y = np.meshgrid(np.arange(120) + 0.5, np.arange(90) + 0.5)
    for right, down in places:
        dots[np.hypot(x - right, y - down) < 6.0] = 2e4
    variance = 0.5 * (dots + 16.8**2)
    noisy = dots + rng.normal(size=dots.shape) * np.sqrt(variance)
    value, sigma = closed_share(noisy, variance, white, places, 8.0)
    assert abs(value - 0.002) < 4.0 * sigma
    assert sigma < 1e-5
    with pytest.raises(CalibrationError, match="closed"):
        closed_share(noisy, variance, white, places, 200.0)
    assert parts_of(white, (3, 4)).shape == (3, 4)


@pytest.mark.parametrize(
    ("then", "now", "verdict"),
    [
        ((0.0, 0.0), (0.0, 0.0), Verdict.GOOD),
        ((7e-6, 3e-6), (-6e-7, 3e-6), Verdict.GOOD),
        ((-7e-6, 3e-6), (6e-6, 3e-6), Verdict.GOOD),
        ((7e-6, 3e-6), (2e-3, 3e-6), Verdict.BAD),
        ((2e-3, 7e-4), (3.5e-3, 7e-4), Verdict.DOUBTFUL),
        ((2e-3, 2e-5), (3.5e-3, 2e-5), Verdict.BAD),
    ],
)
def test_a_black_that_cannot_be_seen_is_not_taken_for_another(
    then: tuple[float, float], now: tuple[float, float], verdict: Verdict
) -> None:
    """Its noise is no change, however large it is over the share that was seen."""
    found = check(
        replace(BENCH.look(2, STRIPS)[0], closed=now), replace(THEN, closed=then),
        BENCH.camera, Map.filling(PROJECTOR_PX), GUARD_PX, T_S,
    )  # fmt: skip
    assert verdicts(found).get("mask.contrast", Verdict.GOOD) == verdict
