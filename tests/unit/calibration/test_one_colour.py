"""A camera without colours measures what the green of one with colours does, to the last digit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from pdcd.calibration.geometry.finding import find_dots
from pdcd.calibration.geometry.fit import FittedMap
from pdcd.calibration.geometry.panel_map import fit_dots, measure_convergence
from pdcd.calibration.light.contrasts import compute_responsivity
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.response.levels import measure_grey_response
from pdcd.calibration.sensor.body import format_profile, make_measured_profile, measure_sensor
from pdcd.sensor.profile import load_profile
from tests.unit.calibration import test_body, test_finding, test_light, test_response


def green_of(photo: QuadPhoto) -> QuadPhoto:
    return QuadPhoto(photo.light[..., 1:2], photo.variance[..., 1:2], photo.saturated)


def greens_of(photos: Mapping[str, QuadPhoto]) -> dict[str, QuadPhoto]:
    return {name: green_of(photo) for name, photo in photos.items()}


def test_contrasts_and_responsivity() -> None:
    photos = test_light.series(1, room=0.008)
    coloured, grey = test_light.measured(photos), test_light.measured(greens_of(photos))
    for name in ("mask", "projector"):
        mine, other = getattr(grey, name), getattr(coloured, name)
        assert mine.value == pytest.approx(other.value, abs=3.0 * mine.sigma)
        assert mine.sigma >= 0.9 * other.sigma  # of fewer samples
    assert grey.rate == pytest.approx(coloured.rate[[1]], rel=0.01)
    value, sigma = compute_responsivity(
        grey, gain_e_per_dn=(2.0, 0.01), f_number=4.0, albedo=0.9, albedo_sigma=0.01
    )
    assert value == pytest.approx(2.0 * grey.rate * 16.0 / 0.9) and sigma.shape == (1,)


def test_grey_levels() -> None:
    photos = test_response.series(test_response.power(2.2))
    coloured = measure_grey_response(photos, test_response.STRIPS)
    grey = measure_grey_response(greens_of(photos), test_response.STRIPS)
    assert len(grey.channel_gammas) == 1
    assert grey.light == pytest.approx(coloured.light, abs=5e-3)
    assert grey.gamma == pytest.approx(2.2, abs=4.0 * grey.gamma_sigma)
    assert grey.gamma_sigma > coloured.gamma_sigma


def test_the_sensor_by_its_one_plane() -> None:
    planes = test_body.series()
    ones = {name: some[1:2] for name, some in planes.items()}
    four, one = (
        measure_sensor(
            photos, test_body.PLAN, iso=100, black_dn=np.full(count, 1024.0), masked=True
        )
        for photos, count in ((planes, 4), (ones, 1))
    )
    assert one.names == ("grey",) and four.names == ("R", "G1", "G2", "B")
    assert one.transfer == four.transfer[1:2] and one.black_dn == four.black_dn[[1]]
    np.testing.assert_allclose(one.lines[0].deviations, four.lines[1].deviations)
    known = load_profile("450d")
    words = {"name": "x", "description": "x", "source": "x"}
    profile = make_measured_profile(one, known, **words)
    assert profile.colours == 1 and "mono = true" in format_profile(profile)
    assert "mono" not in format_profile(make_measured_profile(four, known, **words))


def test_dots_and_no_convergence() -> None:
    white, black, dots = test_finding.bench().photos(test_finding.GRID.shown(1), 0)
    _, green, _ = test_finding.found(test_finding.bench())
    photos = green_of(white), green_of(black), green_of(dots)
    (grey,) = find_dots(*photos, test_finding.GRID, other=test_finding.OTHER, pattern="")
    assert np.array_equal(grey.camera_px, green.camera_px)
    fitted: FittedMap = fit_dots(grey, white.frame, "card")
    places, figures = measure_convergence([fitted], "projector", [fitted])
    assert places.shape == (0, 2, 2) and figures == []
