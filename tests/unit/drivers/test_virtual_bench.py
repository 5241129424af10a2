"""The virtual camera before the mock bench: what it offers there, and what its film is of."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

from drivers.mock.bench import MockBench
from drivers.ptp.codes import APERTURE_CODES, ISO_CODES
from drivers.virtual_camera import BenchFilm, FaultScript, make_bench_backend, make_chart_film
from drivers.virtual_camera.command import make_real_time_body
from drivers.virtual_camera.develop import develop_at_once, start_developer
from drivers.virtual_camera.films import SENSOR_450D, make_scene_film
from drivers.virtual_camera.model import RELEASE_BODY
from drivers.virtual_camera.shutter import CameraExposure
from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import CameraConfig, Config, PanelConfig, SceneConfig, TriggerConfig
from pdcd.errors import ExposureError
from pdcd.sensor.profile import load_profile

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


@pytest.mark.parametrize("fixed", ["auto", 8.0, 1.1, 45.0])
def test_the_bench_has_a_lens_from_1_to_45_in_thirds(fixed: Any) -> None:
    settings = make_bench_backend(context_of(f_number=fixed)).body.settings
    codes = settings.lists[0xD101]
    assert codes == tuple(code for code in range(0x08, 0x61) if code % 8 in (0, 3, 5))
    assert (APERTURE_CODES[codes[0]], APERTURE_CODES[codes[-1]]) == (1.0, 45.0)


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


# Films of its own.


def samples(data: bytes, rows: int, columns: int) -> np.ndarray[Any, Any]:
    """The samples lie at the end of the file."""
    found = np.frombuffer(data[-2 * rows * columns :], "<u2")
    return found.reshape(rows, columns).astype(float)


def seconds(count: float, iso: int = 100, f_number: float | None = 8.0) -> CameraExposure:
    return CameraExposure(0, round(count * 1e9), iso, f_number)


def test_the_chart_is_a_staircase_in_an_even_frame() -> None:
    profile = load_profile("450d")
    gain = profile.row(100).gain_e_per_dn
    rows, columns = 64, 128
    film = make_chart_film((rows, columns), seed=1)
    light = samples(film.make_raw(seconds(0.5)), rows, columns) - profile.black_dn
    steps = light.reshape(rows, 16, 8).mean(axis=2)
    wanted = 20_000.0 * 0.5 * 2.0 ** (-0.5 * np.arange(15, -1, -1)) / gain
    inner = steps[4:-4].mean(axis=0)
    np.testing.assert_allclose(inner, wanted, rtol=0.02, atol=1.0)
    for edge in (steps[:4], steps[-4:]):
        np.testing.assert_allclose(edge.mean(axis=0)[8:], wanted[8:] / 4.0, rtol=0.05, atol=2.0)
    again = make_chart_film((rows, columns), seed=1).make_raw(seconds(0.5))
    np.testing.assert_array_equal(samples(again, rows, columns) - profile.black_dn, light)
    other = make_chart_film((rows, columns), seed=2).make_raw(seconds(0.5))
    assert (samples(other, rows, columns) - profile.black_dn != light).any()
    assert SENSOR_450D == (2848, 4272)


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


def test_a_lens_that_does_not_tell_is_taken_for_f8() -> None:
    told, untold = (
        samples(make_chart_film((32, 64)).make_raw(seconds(1.0, f_number=f)), 32, 64)
        for f in (8.0, None)
    )
    np.testing.assert_array_equal(told, untold)


def test_a_scene_is_spread_over_the_whole_sensor() -> None:
    data = samples(make_scene_film("open-book", (32, 48)).make_raw(seconds(0.5)), 32, 48)
    assert data.shape == (32, 48)
    brightest = data.max() - load_profile("450d").black_dn
    wanted = 20_000.0 * 0.5 / load_profile("450d").row(100).gain_e_per_dn
    assert brightest == pytest.approx(wanted, rel=0.1)


# How files are made.


def test_files_are_made_at_once_or_in_turn_in_one_thread() -> None:
    assert develop_at_once(lambda: b"now").result(timeout=0) == b"now"
    with pytest.raises(ValueError, match="torn"):
        develop_at_once(_torn)
    with start_developer() as develop:
        made = [develop(partial(bytes, number)) for number in range(3)]
        assert [file.result(30.0) for file in made] == [b"", b"\0", b"\0\0"]
    assert all(file.done() for file in made)


def _torn() -> bytes:
    raise ValueError("torn")


def test_a_camera_for_clients_that_wait_runs_in_real_time() -> None:
    film = make_chart_film((32, 64))
    body = make_real_time_body(film, develop_at_once)
    assert isinstance(body.clock, RealClock) and body.model.info.model == "Canon EOS 450D"
