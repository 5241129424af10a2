"""What the virtual camera photographs: alone, and before the mock bench."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.mock.bench import MockBench
from drivers.ptp.codes import ISO_CODES
from drivers.virtual_camera import (
    BenchFilm,
    CameraExposure,
    FaultScript,
    make_bench_backend,
    make_chart_film,
)
from drivers.virtual_camera.films import PlainFilm, make_scene_film
from drivers.virtual_camera.model import RELEASE_BODY
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import CameraConfig, Config, PanelConfig, SceneConfig, TriggerConfig
from pdcd.errors import ExposureError
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


MS = 1_000_000


def context_of(**camera: Any) -> DriverContext:
    config = Config(
        projector=PanelConfig(size_px=(64, 48)),
        mask=PanelConfig(size_px=(80, 60)),
        scene=SceneConfig(grid=(3, 4), ambient=1.0),
        trigger=TriggerConfig(lag_s=0.06, jitter_s=0.0),
        camera=CameraConfig(**{"noise": "none", **camera}),
    )
    return DriverContext(config=config, clock=VirtualClock())


@pytest.mark.parametrize("fixed", [7.7, 4.6, 100.0])
def test_a_lens_of_another_aperture_does_not_tell_it(fixed: float) -> None:
    body = make_bench_backend(context_of(f_number=fixed)).body
    assert body.settings.lists[0xD101] == () and body.settings.f_number is None


def test_isos_are_those_that_body_and_sensor_share() -> None:
    context = context_of()
    offered = make_bench_backend(context, RELEASE_BODY, FaultScript(battery=1)).body
    sensor = set(load_profile(CameraConfig().profile).isos)
    listed = [ISO_CODES[code] for code in offered.settings.lists[0xD103]]
    assert listed == [0, *(iso for iso in (100, 200, 400, 800, 1600) if iso in sensor)]
    assert offered.model.info == RELEASE_BODY.info
    assert offered.settings[0xD111] == 1
    assert offered.clock is context.clock
    assert context.shared.photographed


def test_a_film_opens_and_closes_the_benchs_shutter_late_by_its_lag() -> None:
    context = context_of()
    film, bench = BenchFilm(context), MockBench.of(context)
    assert film.open(1000 * MS) == 1060 * MS == bench.open_ns and bench.shutter_open
    assert film.close(3000 * MS) == 3060 * MS == bench.close_ns and not bench.shutter_open
    exposure = CameraExposure(1060 * MS, 3060 * MS, 100, None)
    data = film.make_raw(exposure)
    assert data[:4] == b"II*\0"
    with pytest.raises(ExposureError):
        film.make_raw(exposure)  # it is read out


@pytest.mark.parametrize(
    ("fixed", "told", "stands"),
    [("auto", None, 8.0), (5.6, None, 5.6), (5.6, 11.0, 11.0), ("auto", 2.0, 2.0)],
)
def test_a_lens_that_does_not_tell_stands_where_it_is_said_to(
    monkeypatch: pytest.MonkeyPatch, fixed: Any, told: float | None, stands: float
) -> None:
    film = BenchFilm(context_of(f_number=fixed))
    asked: list[Any] = []
    monkeypatch.setattr(film._sensor, "dng", lambda *what: asked.append(what) or b"raw")  # type: ignore[func-returns-value]
    assert film.make_raw(CameraExposure(0, 1, 200, told)) == b"raw"
    assert asked == [(200, stands)]


def samples(data: bytes, rows: int, columns: int) -> np.ndarray[Any, Any]:
    """The samples lie at the end of the file."""
    found = np.frombuffer(data[-2 * rows * columns :], "<u2")
    return found.reshape(rows, columns).astype(float)


def seconds(count: float, iso: int = 100, f_number: float | None = 8.0) -> CameraExposure:
    return CameraExposure(0, round(count * 1e9), iso, f_number)


def test_a_film_saturates_where_the_sensor_does() -> None:
    profile = load_profile("450d")
    data = samples(make_chart_film((32, 64)).make_raw(seconds(60.0)), 32, 64)
    assert data[16, -4:].mean() == pytest.approx(
        min(
            profile.white_dn,
            profile.black_dn + profile.full_well_e / profile.row(100).gain_e_per_dn,
        ),
        rel=0.02,
    )
    assert data.max() <= profile.white_dn
    dark = samples(make_chart_film((32, 64)).make_raw(seconds(0.0)), 32, 64)
    assert dark.mean() == pytest.approx(profile.black_dn, abs=1.0)
