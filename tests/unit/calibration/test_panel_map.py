"""Maps out of dots: accurate, with figures; or refused, by what is wrong with them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from pdcd.calibration.figures import Verdict
from pdcd.calibration.geometry.dots import DotGrid
from pdcd.calibration.geometry.finding import Dots, find_dots
from pdcd.calibration.geometry.fit import FittedMap, PointPairs, fit_map
from pdcd.calibration.geometry.panel_map import (
    check_dot_coverage,
    check_fitted_map,
    check_orientation,
    compare_orientation,
    fit_dots,
    list_map_figures,
    measure_convergence,
)
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map
from tests.unit.calibration.geometry_bench import Bench, Way, small_way

FRAME = (320, 480)
GRID = DotGrid.usual("projector", (256, 192))
WAY = small_way(turn_deg=3.0)


@cache
def dots_of() -> Dots:
    white, black, dots = Bench(WAY, small_way("mask", scale=1.9)).photos(GRID.shown(1), 3)
    return find_dots(white, black, dots, GRID)[1]


def error_px(found: FittedMap, way: Way = WAY) -> np.ndarray:
    """Over the dots' part of the panel."""
    quads = np.random.default_rng(1).uniform(0.0, 1.0, (3000, 2)) * FRAME[::-1]
    there = way.to_panel(quads)
    inside = ((there > 8.0) & (there < np.array(way.size_px) - 8.0)).all(axis=-1)
    found_px: np.ndarray = np.hypot(*(found.to_target(quads[inside]) - there[inside]).T)
    return found_px


def test_dots_give_the_map_and_good_figures() -> None:
    found = fit_dots(dots_of(), FRAME)
    assert np.percentile(error_px(found), 50.0) < 0.01
    assert np.percentile(error_px(found), 95.0) < 0.04
    told = {figure.name: figure for figure in list_map_figures(found, "projector")}
    assert all(figure.verdict == Verdict.GOOD for figure in told.values())
    assert told["projector.inliers"].value > 0.97
    assert told["projector.map_px"].value < 0.05


def exact_dots(way: Way, grid: DotGrid, panel_quads: float) -> Dots:
    """Centroids of discs as they are seen, worked out point by point; no photo."""
    quads = np.stack(np.meshgrid(np.arange(480.0), np.arange(320.0)), axis=-1).reshape(-1, 2)
    start = way.to_panel(quads)
    index, seen = [], []
    rows, cols = grid.shape
    for i in range(cols):
        for j in range(rows):
            centre = grid.centres(np.array([[i, j]]))[0]
            near = quads[np.argmin(np.hypot(*(start - centre).T))]
            fine = np.linspace(-panel_quads, panel_quads, 201)
            patch = near + np.stack(np.meshgrid(fine, fine), axis=-1)
            lit = np.hypot(*np.moveaxis(way.to_panel(patch) - centre, -1, 0)) < grid.radius_px
            index.append((i, j))
            seen.append(patch[lit].mean(axis=0))
    camera, where = np.array(seen), np.array(index)
    sigma = np.full(camera.shape, 1e-4)
    return Dots(grid, where, grid.centres(where), camera, sigma, 1.0)


def test_a_disc_is_not_seen_where_its_centre_is() -> None:
    grid = DotGrid("projector", (256, 192), 32, 8.0)
    way = small_way(keystone=(0.25, 0.1), scale=1.3)
    dots = exact_dots(way, grid, 18.0)
    plain = np.hypot(*(way.to_panel(dots.camera_px) - dots.panel_px).T)
    assert np.median(plain) > 0.05
    found = fit_dots(dots, FRAME)
    quads = dots.camera_px
    error = np.hypot(*(found.to_target(quads) - way.to_panel(quads)).T)
    assert np.median(error) < 0.15 * np.median(plain)


def part(keep: Any) -> Dots:
    dots = dots_of()
    names = "index", "panel_px", "camera_px", "sigma_px"
    return replace(dots, **{name: getattr(dots, name)[keep] for name in names})


def test_half_of_the_field_covered_is_refused() -> None:
    for half in (dots_of().index[:, 0] < 8, dots_of().index[:, 1] >= 6):
        with pytest.raises(CalibrationError, match="covers the field"):
            check_dot_coverage(fit_dots(part(half), FRAME), part(half))


def test_dots_are_asked_for_where_the_other_panel_lets_light_pass() -> None:
    """The other panel has other sides, and covers the left five eighths of this one's picture."""
    whole = fit_dots(dots_of(), FRAME)
    left = part(dots_of().index[:, 0] < 10)
    found = fit_dots(left, FRAME)
    with pytest.raises(CalibrationError, match="covers the field"):
        check_dot_coverage(found, left)
    narrow = replace(whole, target_size_px=(256, 192), map=_narrowed(whole.map, 16.0 / 10.0))
    check_dot_coverage(found, left, beside=narrow)


def _narrowed(map_: Map, times: float) -> Map:
    """The map of a panel whose right edge lies nearer by a factor."""
    homography = np.reshape(map_.homography, (3, 3)) * np.array([[times], [1.0], [1.0]])
    return structs.replace(map_, homography=tuple(homography.ravel().tolist()))


def test_a_picture_cut_to_the_other_panel_is_called_swapped() -> None:
    other = DotGrid("mask", (160, 128), 16, 3.0)
    shown = ((dots_of().index + 1) * GRID.pitch_px <= (160, 128)).all(axis=-1)
    with pytest.raises(CalibrationError, match="swapped"):
        check_dot_coverage(fit_dots(part(shown), FRAME), part(shown), other=other)


def test_what_no_smooth_map_fits_is_refused() -> None:
    dots = dots_of()
    rng = np.random.default_rng(3)
    shaken = replace(dots, camera_px=dots.camera_px + rng.normal(0.0, 1.5, dots.camera_px.shape))
    with pytest.raises(CalibrationError, match="no smooth map"):
        fit_dots(shaken, FRAME)
    doubtful = replace(dots, camera_px=dots.camera_px + rng.normal(0.0, 0.25, (len(dots.index), 2)))
    found = fit_dots(doubtful, FRAME)
    told = {figure.name: figure.verdict for figure in list_map_figures(found, "projector")}
    assert told["projector.fit_px"] == Verdict.DOUBTFUL


def test_outliers_beyond_measure_are_refused() -> None:
    found = fit_dots(dots_of(), FRAME)
    inlier, left_px = found.inlier.copy(), found.residual_px.copy()
    inlier[: len(inlier) // 4] = False
    left_px[~inlier] = 0.31, 0.0
    with pytest.raises(CalibrationError, match="25% of the points lie elsewhere"):
        check_fitted_map(replace(found, inlier=inlier, residual_px=left_px), "projector")


FOUND = Map(size_px=(480, 320), homography=(1 / 400, 0, -0.1, 0, 1 / 300, -0.03, 0, 0, 1))


@pytest.mark.parametrize(
    ("believed", "says"),
    [
        (FOUND.then(np.array([[-1, 0, 1], [0, 1, 0], [0, 0, 1]])), "mirrored"),
        (FOUND.then(np.array([[-1, 0, 1], [0, -1, 1], [0, 0, 1]])), "upside down"),
        (FOUND.then(np.array([[0, -1, 1], [1, 0, 0], [0, 0, 1]])), "quarter"),
    ],
)
def test_a_panel_that_lies_another_way_than_believed_is_named(believed: Map, says: str) -> None:
    with pytest.raises(CalibrationError, match=says) as caught:
        check_orientation(FOUND, believed, "mask")
    assert "swapped" in str(caught.value)


def test_a_panel_about_where_it_was_believed_is_fine() -> None:
    turned = FOUND.then(np.array([[0.98, -0.17, 0.1], [0.17, 0.98, 0], [0, 0, 1]]))
    turn, mirrored = compare_orientation(FOUND, turned)
    assert not mirrored
    assert abs(abs(turn) - 9.8) < 3.0
    check_orientation(FOUND, turned, "mask")


def test_a_panel_where_the_other_is_believed_is_called_swapped() -> None:
    elsewhere = FOUND.then(np.array([[2.0, 0, 0.8], [0, 2.0, 0.5], [0, 0, 1]]))
    nearly = FOUND.then(np.array([[1.02, 0, 0.01], [0, 1.02, 0], [0, 0, 1]]))
    with pytest.raises(CalibrationError, match="swapped"):
        check_orientation(FOUND, elsewhere, "projector", other=nearly)
    check_orientation(FOUND, nearly, "projector", other=elsewhere)


def colours(shifts: tuple[float, float, float]) -> list[FittedMap]:
    quads = np.random.default_rng(1).uniform(0.0, 1.0, (600, 2)) * FRAME[::-1]
    there = WAY.to_panel(quads)
    inside = ((there > 0.0) & (there < (256, 192))).all(axis=-1)
    found = []
    for shift in shifts:
        target = there[inside] - (shift, 0.0)
        pairs = PointPairs(quads[inside], target, np.full(target.shape, 0.01))
        found.append(fit_map(pairs, FRAME[::-1], (256, 192), "projector"))
    return found


def test_colours_that_lie_apart_are_told() -> None:
    apart, told = measure_convergence(colours((0.7, 0.0, -0.2)), "projector")
    wanted = np.broadcast_to([[0.7, 0.0], [-0.2, 0.0]], apart.shape)
    np.testing.assert_allclose(apart, wanted, rtol=0.0, atol=0.02)
    assert [figure.verdict for figure in told] == [Verdict.DOUBTFUL, Verdict.GOOD]
    assert told[0].value == pytest.approx(0.7, abs=0.02)


def test_what_both_panels_show_alike_is_the_cameras() -> None:
    camera_only = colours((0.4, 0.0, -0.3))
    apart, told = measure_convergence(colours((0.7, 0.0, -0.2)), "projector", camera_only)
    wanted = np.broadcast_to([[0.3, 0.0], [0.1, 0.0]], apart.shape)
    np.testing.assert_allclose(apart, wanted, rtol=0.0, atol=0.03)
    assert [figure.verdict for figure in told] == [Verdict.GOOD, Verdict.GOOD]
