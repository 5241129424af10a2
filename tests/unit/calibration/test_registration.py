"""Stripes on both panels, on a bench that nobody told the estimators about."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.registration.correction import (
    MapCorrection,
    adjust_map_residual,
    correct_mask_map,
    fit_map_correction,
)
from pdcd.calibration.registration.offsets import (
    MaskOffsets,
    StripeSeries,
    StripeSeriesBuilder,
    find_nearest,
    measure_mask_offsets,
)
from pdcd.calibration.registration.stripes import (
    FINE,
    RULER,
    StripePlan,
    choose_stripe_periods,
    make_stripe_sequences,
)
from pdcd.calibration.shown import PanelSequence
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map
from tests.unit.calibration.ruler_bench import RulerBench, misplaced

Floats = NDArray[np.float64]

SIZES = {"projector_px": (192, 144), "mask_px": (300, 225), "frame": (230, 172)}


@cache
def shown(kind: StripePlan, projector: Map, mask: Map) -> tuple[PanelSequence, ...]:
    """The pictures of one series; most tests believe the same maps."""
    return tuple(make_stripe_sequences(kind, projector, mask))


def measure(
    stripes: StripePlan,
    photos: Iterable[QuadPhoto],
    white: QuadPhoto,
    camera: Map,
    projector: Map,
    *,
    placed: bool = False,
) -> StripeSeries:
    gathering = StripeSeriesBuilder(stripes, white, camera, projector)
    for photo in photos:
        gathering.add(photo)
    return gathering.series(placed=placed)


@dataclass
class Session:
    """A bench, and what is believed of it."""

    bench: RulerBench
    camera: Map
    mask: Map
    white: QuadPhoto = field(init=False)

    def __post_init__(self) -> None:
        self.white = self.bench.white()

    def one_series(self, kind: StripePlan, mask: Map | None = None) -> StripeSeries:
        bench = self.bench
        photos = (bench.photo(each) for each in shown(kind, bench.projector, mask or self.mask))
        return measure(kind, photos, self.white, self.camera, bench.projector)

    def series(
        self, kinds: Sequence[StripePlan], mask: Map | None = None
    ) -> tuple[StripeSeries, StripeSeries]:
        right, down = (self.one_series(kind, mask) for kind in kinds)
        return right, down

    def offsets(self, mask: Map) -> tuple[MaskOffsets, MapCorrection]:
        coarse = measure_mask_offsets(*self.series(RULER, mask), self.camera, mask)
        first = fit_map_correction(coarse, mask)
        near = correct_mask_map(mask, self.bench.projector, first)
        left = measure_mask_offsets(*self.series(FINE, near), self.camera, near, corrected=True)
        found = replace(left, offset_px=left.offset_px + first.at(left.points_px))
        return found, fit_map_correction(found, mask)


def session(seed: int, blur_px: tuple[float, float] = (0.5, 0.5), **more: float) -> Session:
    bench = RulerBench(seed=seed, blur_px=blur_px, **SIZES, **more)  # type: ignore[arg-type]
    size = bench.projector_px
    return Session(
        bench,
        misplaced(bench.camera, size, seed + 5, 0.5),
        misplaced(bench.mask, size, seed + 6, 2.0),
    )


@cache
def some() -> Session:
    return session(20)


@cache
def one() -> Session:
    return session(10, (0.4, 0.7))


@cache
def measured() -> tuple[MaskOffsets, MapCorrection]:
    return one().offsets(one().mask)


@cache
def again() -> tuple[Map, MaskOffsets, MapCorrection]:
    mask = correct_mask_map(one().mask, one().bench.projector, measured()[1])
    return (mask, *one().offsets(mask))


def lengths(bench: RulerBench, mask: Map) -> Floats:
    return np.asarray(np.hypot(*bench.offset_px(mask, bench.seen_points()).T))


@pytest.mark.long
def test_the_offset_is_found_and_taken_out() -> None:
    bench, (found, _) = one().bench, measured()
    assert np.median(lengths(bench, one().mask)) > 0.5
    wrong = found.offset_px - bench.offset_px(one().mask, found.points_px)
    assert np.quantile(np.abs(wrong), 0.95) < 0.06
    mask, second, correction = again()
    assert second.e95_px < 0.08
    left = lengths(bench, correct_mask_map(mask, bench.projector, correction))
    assert np.quantile(left, 0.95) < 0.06
    assert np.median(left) < 0.015


@pytest.mark.long
def test_errors_are_as_large_as_said() -> None:
    mask, _, correction = again()
    points = one().bench.seen_points()
    wrong = correction.at(points) - one().bench.offset_px(mask, points)
    ratio = wrong / correction.sigma_at(points)
    assert 0.6 < np.sqrt(np.mean(ratio**2)) < 1.6


def test_slow_panels_move_no_stripes() -> None:
    fast, slow = deepcopy(some()), deepcopy(some())
    slow.bench.taus_s = (4e-3, 9e-3)
    slow.white = slow.bench.white()
    found = [each.one_series(RULER[0]) for each in (fast, slow)]
    assert np.abs(np.mean(found[0].offset_px - found[1].offset_px)) < 0.01


@pytest.mark.long
def test_texture_and_smooth_light_drop_out() -> None:
    plain, rough = deepcopy(some()), deepcopy(some())
    texture = np.random.default_rng(1).random(rough.bench.albedo.shape)
    rough.bench.albedo = np.asarray(0.4 + 0.6 * texture)
    rough.bench.ambient = 0.5
    rough.white = rough.bench.white()
    found = [each.one_series(RULER[0]) for each in (plain, rough)]
    same = find_nearest(found[0].quads, found[1].quads)
    apart = found[0].offset_px - found[1].offset_px[same]
    assert np.median(np.abs(apart)) < 0.01
    # Light of the room makes stripes shallower, all of them alike.
    assert np.median(found[1].modulation) < 0.8 * np.median(found[0].modulation)


def test_a_correction_is_a_map_like_any_other() -> None:
    mask, bench = one().mask, one().bench
    correction = measured()[1]
    better = correct_mask_map(mask, bench.projector, correction)
    points = bench.seen_points()
    moved = bench.offset_px(mask, points) - bench.offset_px(better, points)
    np.testing.assert_allclose(moved, correction.at(points), atol=2e-3)
    same = adjust_map_residual(mask, mask.to_field, (7, 9), "mask")  # half-way between 4 x 5 nodes
    np.testing.assert_allclose(same.to_field(points), mask.to_field(points), atol=1e-5)


TURN = np.radians(12.0)
TURNED = [
    [np.cos(TURN), -np.sin(TURN), 0.2], [np.sin(TURN), np.cos(TURN), -0.1], [0.0, 0.0, 1.0],
]  # fmt: skip
MIRRORED = [[-1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
UPSIDE_DOWN = [[-1.0, 0.0, 1.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]]
FAR = [[1.0, 0.0, 7.4 / SIZES["projector_px"][0]], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("changed", "believed", "said"),
    [
        ({"electrons": 0.1}, None, "there is no light"),
        ({"blur_px": (9.0, 9.0)}, None, "do not modulate"),
        ({"leak": 1.0}, None, "shows no stripes|times the light"),
        ({}, lambda it: it.mask.then(MIRRORED), "mirrored or upside down"),
        ({}, lambda it: it.mask.then(UPSIDE_DOWN), "mirrored or upside down"),
        ({}, lambda it: it.bench.mask.then(FAR), "px or more apart"),
        ({}, lambda it: it.bench.mask.then(TURNED), "not where the maps|px or more apart"),
    ],
)
def test_what_is_wrong_with_a_bench_is_named(
    changed: dict[str, Any], believed: Callable[[Session], Map] | None, said: str
) -> None:
    it = deepcopy(some())
    for name, value in changed.items():
        setattr(it.bench, name, value)
    if changed:
        it.white = it.bench.white()
    if believed:
        it.mask = believed(it)
    refused(it, said)


def refused(it: Session, said: str) -> None:
    with pytest.raises(CalibrationError, match=said) as failed:
        measure_mask_offsets(*it.series(RULER), it.camera, it.mask)
    assert failed.value.hint


def test_what_is_wrong_with_photos_is_named() -> None:
    full, half, dark, dim = (deepcopy(some()) for _ in range(4))
    full.white = replace(
        full.white, saturated=full.white.light[..., 1] > 0.9 * full.white.light.max()
    )
    refused(full, "saturated")
    half.bench.albedo[:, : half.bench.frame[0] // 2] = 0.02
    half.white = half.bench.white()
    refused(half, "of the field only")
    dark.bench.electrons *= 1e-3
    refused(dark, "are black")
    dim.white = QuadPhoto(dim.white.light * 0.2, dim.white.variance)
    refused(dim, "times the light")


def test_stripes_finer_than_the_camera_sees_are_measured_once_longer_ones_told_where() -> None:
    found = session(10, relay_quads=2.6)
    bench, kind = found.bench, FINE[0]
    photos = [bench.photo(each) for each in shown(kind, bench.projector, bench.mask)]
    known = (found.white, bench.camera, bench.projector)
    with pytest.raises(CalibrationError, match="not where the maps have them"):
        measure(kind, photos, *known)
    series = measure(kind, photos, *known, placed=True)
    assert np.median(np.abs(series.offset_px)) < 0.03


def test_the_next_stripe_is_not_taken_for_the_right_one() -> None:
    it = deepcopy(some())
    wrong = np.eye(3)
    wrong[0, 2] = 16.0 / it.bench.projector_px[0]
    it.mask = it.bench.mask.then(wrong)
    first = measure_mask_offsets(*it.series(RULER), it.camera, it.mask)
    assert first.e95_px < 1.0  # 16 px stripes see nothing of it
    with pytest.raises(CalibrationError, match="neighbours"):
        measure_mask_offsets(*it.series(FINE), it.camera, it.mask, corrected=True)


@pytest.mark.parametrize("from_step", [3, 5])
@pytest.mark.parametrize("what", ["mask", "lamp"])
def test_a_bench_that_changes_amid_the_series_is_noticed(what: str, from_step: int) -> None:
    it = deepcopy(some())
    photos = []
    for step, each in enumerate(shown(RULER[0], it.bench.projector, it.mask)):
        if what == "mask" and step == from_step:
            moved = np.eye(3)
            moved[0, 2] = 0.5 / it.bench.projector_px[0]
            it.bench.mask = it.bench.mask.then(moved)
            it.bench.look()
        lamp = 0.9 if what == "lamp" and step >= from_step else 1.0
        photos.append(it.bench.photo(each, lamp=lamp))
    with pytest.raises(CalibrationError, match="moved during the series"):
        measure(RULER[0], photos, it.white, it.camera, it.bench.projector)


def test_stripes_are_as_wide_as_the_mask_can_show() -> None:
    """A period of the finest has three pixels of the mask, or more."""
    for mask_px in (0.64, 1.3, 1.9, 3.0):
        coarse, fine = (pair[0].period_px for pair in choose_stripe_periods(mask_px))
        assert coarse > fine >= 3.0 * mask_px
        # An offset by half of what both agree on is not taken for none.
        assert np.lcm(coarse, fine) >= 48
