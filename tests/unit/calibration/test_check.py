"""The check before a session: what it must find, and that it cries no wolf."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.check.changes import (
    BenchSnapshot,
    CheckResult,
    average_parts,
    compare_snapshots,
    measure_closed_mask,
)
from pdcd.calibration.check.moved import fit_map_drift as fitted
from pdcd.calibration.figures import Verdict
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, map_between

Floats = NDArray[np.float64]

PROJECTOR_PX, MASK_PX, FRAME = (1024, 768), (1600, 1200), (2136, 1424)
T_S = 1.0 / 60.0
GUARD_PX = 4.0
DOT_PX = 0.03
"""Noise of a dot, in projector pixels."""
PX_QUADS = 1.8
"""Quads along a projector pixel, about."""
EPS = 1.0 / 500.0
LAG_S = 1e-5
"""Noise of the lag."""


def turned(degrees: float, right_px: float = 0.0, down_px: float = 0.0) -> Floats:
    """A turn about the middle of the field, and a shift, in projector pixels, from field to
    field."""
    width, height = PROJECTOR_PX
    to_px = np.array([[width, 0.0, -0.5 * width], [0.0, height, -0.5 * height], [0.0, 0.0, 1.0]])
    angle = np.radians(degrees)
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, right_px], [sin, cos, down_px], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.inv(to_px) @ turn @ to_px)


def dots_of(size_px: tuple[int, int], pitch: int) -> NDArray[np.int64]:
    """Row and column of each dot of a panel."""
    col, row = np.meshgrid(*(np.arange(1, side // pitch) for side in size_px))
    return np.stack([row.ravel(), col.ravel()], axis=-1)


@cache
def seen_dots(panel: Map, camera: Map, pitch: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Where the camera sees them, and which it sees."""
    quads = map_between(panel, camera, dots_of(panel.size_px, pitch)[:, ::-1] * float(pitch))
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

    def look(self, seed: int) -> BenchSnapshot:
        """What the photos of a check say of it, with full noise, by the maps of `BENCH`."""
        rng = np.random.default_rng(seed)
        projector, known = Map.filling(PROJECTOR_PX), BENCH

        def seen(panel: Map, pitch: int) -> tuple[Floats, Floats]:
            quads, good = seen_dots(panel, self.camera, pitch)
            quads = quads[good] + rng.normal(0.0, DOT_PX * PX_QUADS, (good.sum(), 2))
            # A few lie on edges of the scene.
            off = rng.random(len(quads)) < 0.02
            quads[off] += rng.normal(0.0, 0.8 * PX_QUADS, (off.sum(), 2))
            dots = dots_of(panel.size_px, pitch)[good][:, ::-1]
            return np.asarray(dots * float(pitch), dtype=np.float64), np.asarray(quads)

        def sigma(points: Floats) -> Floats:
            return np.full(len(points), DOT_PX)

        dots, quads = seen(projector, 32)
        on_picture = map_between(known.camera, projector, quads)
        camera = fitted(PROJECTOR_PX, on_picture, dots, sigma(dots))
        dots, quads = seen(self.mask, 40)
        believed = map_between(known.mask, projector, dots)
        on_picture = camera(map_between(known.camera, projector, quads))
        mask = fitted(PROJECTOR_PX, believed, on_picture, sigma(dots))
        fields = np.linspace(1.0, 0.7, 16) * np.linspace(0.8, 1.0, 12)[:, None]
        white = 2e4 * self.lamp * fields * (1.0 + 2e-3 * rng.normal(size=fields.shape))
        white *= 1.0 + 4e-3 * rng.normal()  # the lamp is not that steady
        lag = self.skew_s - known.skew_s + LAG_S * rng.normal(), LAG_S
        closed = self.eps * (1.0 + 0.01 * rng.normal())
        settings = {"camera": "450D 0123", "iso": self.iso, "f_number": "4"}
        return BenchSnapshot(camera, mask, white, (closed, 0.01 * EPS), lag, settings)


def a_bench(seed: int = 0) -> Bench:
    rng = np.random.default_rng(seed)
    camera = Map.filling(FRAME).then(turned(0.7)).then(np.diag([1.05, 1.05, 1.0]))
    camera = msgspec.structs.replace(camera, radial=(0.03, 0.0))
    mask = Map.filling(MASK_PX).then(turned(-0.4, *rng.uniform(-3.0, 3.0, 2)))
    return Bench(camera, mask)


BENCH = a_bench()
THEN = BENCH.look(1)


def checked(bench: Bench, seed: int = 2) -> CheckResult:
    return compare_snapshots(bench.look(seed), THEN, GUARD_PX, T_S)


def verdicts(found: CheckResult) -> dict[str, Verdict]:
    return {f.figure.name: f.figure.verdict for f in found.findings if f.figure.verdict}


@pytest.mark.long
def test_a_hundred_unchanged_benches_raise_no_alarm() -> None:
    worst = {"mask.place": 0.0, "camera.place": 0.0}
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
            {"camera.place": BAD},
            "the camera was bumped",
        ),
        (lambda b: replace(b, iso="200"), {"settings": BAD}, "iso is 200 and was 100"),
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
    there = replace(moved(bumped(BENCH, 2.0), 1.0), lamp=0.95, skew_s=2.3e-3)
    found = checked(there)
    corner = np.array([[0.0, 0.0], [1024.0, 768.0]])
    np.testing.assert_allclose(found.mask(corner) - corner, [[0.64, 0.0]] * 2, atol=0.02)
    assert found.lamp == pytest.approx(0.95, abs=0.02)
    # The refitted maps have both devices where they are now.
    points = np.array([[1000.0, 700.0], [300.0, 300.0]])
    for was, now, by in (
        (BENCH.camera, there.camera, found.camera),
        (BENCH.mask, there.mask, found.mask),
    ):
        off = was.then(by.of_field).to_field(points) - now.to_field(points)
        np.testing.assert_allclose(off * PROJECTOR_PX, 0.0, atol=0.04)


def test_what_no_similarity_explains_calls_for_a_new_calibration() -> None:
    bent = msgspec.structs.replace(BENCH.mask, radial=(0.003, 0.0))
    assert verdicts(checked(replace(BENCH, mask=bent)))["mask.place"] is BAD


def test_photos_that_say_nothing_are_refused() -> None:
    now = BENCH.look(3)
    few = replace(now.mask, count=40)
    bad = [
        (replace(now, white=0.01 * now.white), "almost no light"),
        (replace(now, saturated=0.2), "saturated"),
        (replace(now, mask=few), "dots of the mask"),
    ]
    for look, said in bad:
        with pytest.raises(CalibrationError, match=said):
            compare_snapshots(look, THEN, GUARD_PX, T_S)
    unknown = (float("nan"), float("nan"))
    for nothing, figure in (
        (replace(now, closed=unknown), "mask.contrast"),
        (replace(now, lag_s=unknown), "mask.skew_s"),
    ):
        found = compare_snapshots(nothing, THEN, GUARD_PX, T_S)
        assert verdicts(found) == {figure: BAD}
    shifted = replace(moved(BENCH, 1.0).look(3), lag_s=unknown)
    found = compare_snapshots(shifted, THEN, GUARD_PX, T_S)
    assert verdicts(found) == {"mask.place": REFIT, "mask.skew_s": REFIT}


def test_another_scene_is_not_taken_for_a_lamp() -> None:
    now = BENCH.look(3)
    rng = np.random.default_rng(0)
    other = replace(now, white=now.white * rng.uniform(0.4, 1.0, now.white.shape))
    found = compare_snapshots(other, THEN, GUARD_PX, T_S)
    assert verdicts(found) == {"lamp": REFIT}
    assert "the scene differs" in found.findings[3].advice


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
    value, sigma = measure_closed_mask(noisy, variance, white, places, 8.0)
    assert abs(value - 0.002) < 4.0 * sigma
    assert sigma < 1e-5
    with pytest.raises(CalibrationError, match="closed"):
        measure_closed_mask(noisy, variance, white, places, 200.0)
    assert average_parts(white, (3, 4)).shape == (3, 4)


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
    found = compare_snapshots(
        replace(BENCH.look(2), closed=now), replace(THEN, closed=then), GUARD_PX, T_S
    )
    assert verdicts(found).get("mask.contrast", Verdict.GOOD) == verdict
