"""What the virtual camera photographs when it stands alone."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
import pytest

from drivers.virtual_camera import CameraExposure, make_chart_film
from drivers.virtual_camera.films import PlainFilm, make_scene_film
from pdcd.bench.tables import SceneConfig
from pdcd.errors import ConfigError
from pdcd.sensor.profile import compute_variance_dn2, load_profile
from pdcd.sensor.raw import RawFrame, read_raw
from pdcd.virtual.scene.build import build_scene

SECOND = CameraExposure(0, 1_000_000_000, iso=100, f_number=8.0)


def photo(film: PlainFilm, exposure: CameraExposure = SECOND) -> RawFrame:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "photo.dng"
        path.write_bytes(film.make_raw(exposure))
        return read_raw(path)


def test_the_chart_goes_up_in_half_stops() -> None:
    shown = photo(make_chart_film((64, 320)))
    middle = shown.planes[:, 8:24].reshape(4, 16, 16, 10)  # plane, row, step, column
    steps = middle.mean(axis=(0, 1, 3))
    gain_e_per_dn = 2.96  # of the 450D profile at ISO 100
    assert steps[-1] == pytest.approx(20_000.0 / gain_e_per_dn, rel=0.01)
    np.testing.assert_allclose(steps[-6:-1] / steps[-5:], 2.0**-0.5, rtol=0.02)
    assert shown.iso == 100
    assert shown.exposure_s == pytest.approx(1.0)


def test_two_stops_down_is_a_quarter_of_the_light() -> None:
    bright = photo(make_chart_film((64, 320))).planes.mean()
    dark = photo(
        make_chart_film((64, 320)), CameraExposure(0, 10**9, iso=100, f_number=16.0)
    ).planes.mean()
    assert dark == pytest.approx(bright / 4.0, rel=0.02)


def test_noise_is_that_of_the_sensor_model() -> None:
    """The camera draws it in a faster way of its own: mean and spread must be the model's."""
    profile = load_profile("450d")
    film, shape = make_chart_film((64, 640)), (4, 16, 16, 20)  # plane, row, step, column
    first, second = (photo(film).planes[:, 8:24].reshape(shape).astype(float) for _ in range(2))
    spread = (first - second).std(axis=(0, 1, 3)) / math.sqrt(2.0)
    light_e = 20_000.0 * 2.0 ** (-0.5 * (15 - np.arange(16)))
    signal_dn = light_e / profile.row(100).gain_e_per_dn
    model = np.sqrt(compute_variance_dn2(signal_dn, profile, 100, 1.0))
    np.testing.assert_allclose(spread, model, rtol=0.1)  # 1280 samples: 2 %, and 5 sigmas of it


def test_a_scene_looks_as_it_does_in_white_light() -> None:
    scene = build_scene(SceneConfig(kind="open-book"))
    rows, columns = scene.grid
    shown = photo(make_scene_film("open-book", (4 * rows, 4 * columns))).planes
    red, green, blue = scene.white().reshape(rows, columns, 3).transpose(2, 0, 1)
    for plane, truth in zip(shown, (red, green, green, blue), strict=True):
        cells = plane.reshape(rows, 2, columns, 2).mean(axis=(1, 3))
        assert np.corrcoef(cells.ravel(), truth.ravel())[0, 1] > 0.99


def test_an_unknown_scene_is_refused() -> None:
    with pytest.raises(ConfigError):
        make_scene_film("no-such-scene")
