"""Dots in photos of a bench on paper: found however the panel lies; or why they are not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pdcd.calibration.geometry.dots import DotGrid
from pdcd.calibration.geometry.finding import Dots, find_dots
from pdcd.calibration.photo import QuadPhoto
from pdcd.errors import CalibrationError
from tests.unit.calibration.geometry_bench import Bench, Way, small_way

GRID = DotGrid.usual("projector", (256, 192))
OTHER = DotGrid.usual("mask", (320, 240))
FRAME = (320, 480)
BESIDE_A_HOLE = np.zeros(FRAME)
BESIDE_A_HOLE[120:220, 200:300] = 1.0


def bench(way: Way | None = None, **changes: Any) -> Bench:
    return replace(Bench(way or small_way(), small_way("mask", scale=1.9)), **changes)


def found(bench: Bench, seed: int = 0, grid: DotGrid = GRID) -> tuple[Dots, ...]:
    white, black, dots = bench.photos(grid.shown(1), seed)
    return find_dots(white, black, dots, grid, other=OTHER)


@pytest.mark.parametrize(
    "way",
    [
        small_way(turn_deg=3.0),
        small_way(turn_deg=180.0, keystone=(0.15, 0.1)),
        small_way(turn_deg=92.0, mirrored=True, scale=1.15),
        small_way(turn_deg=-41.0, mirrored=True, scale=1.05),
        small_way(turn_deg=15.0, scale=2.6, shift_quads=(60.0, -40.0)),
    ],
)
def test_each_dot_is_told_apart_however_the_panel_lies(way: Way) -> None:
    _, dots, _ = found(bench(way))
    error = np.hypot(*(way.to_panel(dots.camera_px) - dots.panel_px).T)
    assert error.max() < 0.15
    assert np.percentile(error, 50.0) < 0.05
    assert len(dots.index) > 60


def test_dots_of_the_mask_are_found_upside_down_and_on_texture() -> None:
    rng = np.random.default_rng(6)
    scene = np.kron(rng.uniform(0.3, 1.0, (8, 12)), np.ones((40, 40)))
    mask = small_way("mask", turn_deg=180.0)
    made = Bench(small_way(scale=2.0), mask, texture=np.asarray(scene, dtype=np.float64))
    white, black, dots = made.photos(OTHER.shown(1), 1)
    _, found_, _ = find_dots(white, black, dots, OTHER, other=GRID)
    error = np.hypot(*(mask.to_panel(found_.camera_px) - found_.panel_px).T)
    assert np.percentile(error, 95.0) < 0.1


@pytest.mark.long
def test_errors_of_dots_are_honest() -> None:
    way = small_way(turn_deg=7.0)
    ratios = []
    for seed in range(3):
        _, dots, _ = found(bench(way, electrons=400.0), seed)
        # The lens bends within a dot: its slope turns errors in the photo to those on the panel.
        step = 0.5
        there = way.to_panel(dots.camera_px)
        right = way.to_panel(dots.camera_px + np.array([step, 0.0])) - there
        down = way.to_panel(dots.camera_px + np.array([0.0, step])) - there
        sigma = np.sqrt((dots.sigma_px[:, :1] * right) ** 2 + (dots.sigma_px[:, 1:] * down) ** 2)
        ratios.append((there - dots.panel_px) / (sigma / step))
    assert 0.85 < np.concatenate(ratios).std() < 1.15


@pytest.mark.parametrize(
    ("cause", "changes"),
    [
        ("too dim", {"electrons": 20.0}),
        ("saturated", {"electrons": 60_000.0}),
        ("out of focus", {"blur_quads": 4.0}),
        ("dots", {"blur_quads": 9.0}),
        ("were found", {"covered": BESIDE_A_HOLE}),
    ],
)
def test_what_cannot_be_measured_is_named(cause: str, changes: dict[str, Any]) -> None:
    with pytest.raises(CalibrationError, match=cause) as caught:
        found(bench(**changes))
    assert caught.value.hint


def test_texture_is_divided_out_until_it_is_too_strong() -> None:
    rng = np.random.default_rng(2)
    fine = np.kron(rng.uniform(0.1, 1.0, (64, 96)), np.ones((5, 5)))
    with pytest.raises(CalibrationError, match="texture is too strong"):
        found(bench(texture=fine, electrons=30_000.0))
    coarse = np.kron(rng.uniform(0.4, 1.0, (4, 6)), np.ones((80, 80)))
    way = small_way()
    _, dots, _ = found(bench(way, texture=coarse))
    error = np.hypot(*(way.to_panel(dots.camera_px) - dots.panel_px).T)
    assert np.percentile(error, 95.0) < 0.1


def photos() -> list[QuadPhoto]:
    return bench().photos(GRID.shown(1), 1)


def test_pictures_that_were_not_shown_are_named() -> None:
    white, black, dots = photos()
    with pytest.raises(CalibrationError, match="photo of dots is black"):
        find_dots(white, black, black, GRID)
    with pytest.raises(CalibrationError, match="photo of dots is white"):
        find_dots(white, black, white, GRID)
    plain = replace(white, light=white.light.copy())
    plain.light[..., :] = np.median(white.light)
    with pytest.raises(CalibrationError, match="cannot be told apart"):
        find_dots(plain, black, dots, GRID)


def test_dots_of_the_other_panel_are_recognised() -> None:
    asked = DotGrid.usual("mask", (256, 192))
    white, black, dots = photos()
    with pytest.raises(CalibrationError, match="dots of the projector") as caught:
        find_dots(white, black, dots, asked, other=GRID)
    assert "swapped" in str(caught.value)
