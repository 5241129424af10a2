"""Parallax between mask and projector, with two pinholes and two cards worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.calibration.geometry.coaxial import Parallax, parallax
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, matrix

Floats = NDArray[np.float64]

PROJECTOR_PX, MASK_PX = (1024, 768), (1600, 1200)
FOCAL_PX, MASK_FOCAL_PX = 1500.0, 2300.0


def maps(apart_m: Floats, z_m: float, error_px: Floats | None = None) -> tuple[Map, Map]:
    """The mask's and the projector's map of a card: the projector's picture is the field.

    A mask's pixel sends a ray from its centre of projection, which is `apart_m` from the
    projector's; where it meets the card, the projector's pixel is told by four corners.
    """
    corners = np.array([[0.0, 0.0], [1600.0, 0.0], [0.0, 1200.0], [1600.0, 1200.0]])
    rays = (corners - (800.0, 600.0)) / MASK_FOCAL_PX
    met = apart_m[:2] + rays * (z_m - apart_m[2])
    on_projector = met / z_m * FOCAL_PX + (512.0, 384.0)
    if error_px is not None:
        on_projector = on_projector + error_px
    rows = []
    for (x, y), (u, v) in zip(corners, on_projector / PROJECTOR_PX, strict=True):
        rows.append([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y])
        rows.append([0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y])
    solved = np.linalg.solve(np.array(rows), (on_projector / PROJECTOR_PX).ravel())
    whole = np.append(solved, 1.0).reshape(3, 3)
    return Map(size_px=MASK_PX, homography=matrix(whole)), Map.filling(PROJECTOR_PX)


def found(
    apart_m: Floats,
    distances_m: tuple[float, float] = (1.0, 1.1),
    error_px: tuple[Floats | None, Floats | None] = (None, None),
    sigma_px: float = 0.02,
) -> Parallax:
    pairs = [maps(apart_m, z, e) for z, e in zip(distances_m, error_px, strict=True)]
    cards, projectors = zip(*pairs, strict=True)
    return parallax(cards, projectors, distances_m, FOCAL_PX, sigma_px)


def test_the_distance_of_the_centres_is_found() -> None:
    apart = np.array([0.002, -0.003, 0.005])
    result = found(apart)
    np.testing.assert_allclose(result.apart_m, apart, atol=6e-5)
    assert result.sideways_m == pytest.approx(np.hypot(0.002, 0.003), abs=5e-5)


def test_its_error_is_that_of_the_maps() -> None:
    # 0.02 px in each map, the same over the field, the worst there is.
    rng = np.random.default_rng(1)
    apart = np.array([0.001, 0.0, 0.0])
    errors = []
    for _ in range(40):
        shifts = [np.broadcast_to(rng.normal(0.0, 0.02, 2), (4, 2)) for _ in (0, 1)]
        result = found(apart, error_px=(shifts[0], shifts[1]))
        errors.append((result.apart_m - apart)[:2] / np.sqrt(np.diag(result.covariance))[:2])
    assert 0.8 < np.std(errors) < 1.2
    assert result.sideways_sigma_m == pytest.approx(0.02 * np.sqrt(2) / (1500 * 0.0909), rel=0.02)


def test_what_it_means_for_a_scene() -> None:
    result = found(np.array([0.002, 0.0, 0.0]))
    assert result.offset_px(1.0, 1.1) == pytest.approx(1500 * 0.002 * 0.0909, rel=0.03)
    deepest = result.deepest_m(1.0, 0.3)
    assert result.offset_px(1.0, deepest) == pytest.approx(0.3, rel=1e-6)
    assert found(np.zeros(3)).deepest_m(1.0, 0.3) == np.inf


def test_what_is_no_parallax_is_told() -> None:
    tilted = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 1.0], [-2.0, 0.5]])
    with pytest.raises(CalibrationError, match="no parallax"):
        found(np.zeros(3), error_px=(tilted, None))


def test_cards_must_be_apart_and_seen() -> None:
    with pytest.raises(CalibrationError, match="tell no parallax"):
        found(np.zeros(3), (1.0, 1.0))
    with pytest.raises(CalibrationError, match="tell no parallax"):
        found(np.zeros(3), (1.0, -1.1))
    beside = np.full((4, 2), 900.0)
    with pytest.raises(CalibrationError, match="of the mask only"):
        found(np.zeros(3), error_px=(beside, None))
