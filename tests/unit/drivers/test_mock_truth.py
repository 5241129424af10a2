"""The mock drivers on a bench that is not what its configuration says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mock.bench import MockBench
from drivers.mock.camera import BenchSensor, make_true_profile
from drivers.mock.shutter import MockShutter
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    PanelConfig,
    SceneConfig,
    ScheduleConfig,
)
from pdcd.bench.truth import TrueSensor
from pdcd.capture.rig import Rig
from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import read_raw

GRID = (6, 8)


def config_of(folder: Path, truth: str, **camera: Any) -> Config:
    path = folder / "truth.toml"
    path.write_text(truth)
    return Config(
        projector=PanelConfig(size_px=(64, 48)),
        mask=PanelConfig(size_px=(80, 60)),
        camera=CameraConfig(noise="none", **camera),
        scene=SceneConfig(grid=GRID, ambient=0.5),
        bench=BenchConfig(truth=str(path)),
    )


def dark_photo(folder: Path, config: Config, name: str) -> NDArray[np.floating]:
    """A photo of ambient light only, (4, h, w): the shutter opens, nothing is shown."""
    bench = MockBench.of(DriverContext(config=config, clock=VirtualClock()))
    sensor = BenchSensor(bench, config.camera)
    bench.open_shutter(0)
    bench.close_shutter(10_000_000_000)
    path = folder / f"{name}.dng"
    path.write_bytes(sensor.dng(100, 1.0))
    return read_raw(path, saturation_dn=1e9).planes


def test_ambient_light_is_that_of_the_truth_at_quads_of_any_number(tmp_path: Path) -> None:
    """Through a black mask that leaks by the contrast of the truth."""
    truth = "[mask]\ncontrast = 100.0\n[scene]\nambient = 0.25\n"
    config = config_of(tmp_path, truth, frame_quads=(31, 23), responsivity_e=(8e4, 8e4, 8e4))
    planes = dark_photo(tmp_path, config, "a")
    assert planes.shape[-2:] == (23, 31)
    row = load_profile(config.camera.profile).row(100)
    wanted = 8e4 * 10.0 * 0.25 / 100.0 / row.gain_e_per_dn
    np.testing.assert_allclose(planes, wanted, atol=0.51)


def test_samples_differ_as_much_as_said_and_the_same_way_in_every_photo(tmp_path: Path) -> None:
    truth = "[mask]\ncontrast = 2.0\n[sensor]\nprnu = 0.02\ngain = 1.5\n"
    config = config_of(tmp_path, truth, frame_quads=(64, 48), responsivity_e=(1e3, 1e3, 1e3))
    first, second = (dark_photo(tmp_path, config, name) for name in "ab")
    np.testing.assert_array_equal(first, second)
    row = load_profile(config.camera.profile).row(100)
    level = 1e3 * 10.0 * 0.5 / 2.0 * 1.5 / row.gain_e_per_dn
    assert first.mean() == pytest.approx(level, rel=2e-3)
    assert first.std() == pytest.approx(0.02 * level, rel=0.05)


def test_a_sensor_is_off_its_profile_by_factors() -> None:
    profile = load_profile("modern")
    true = make_true_profile(profile, TrueSensor(gain=2.0, read_noise=1.5, dark=3.0, full_well=0.5))
    assert true.rows[0].gain_e_per_dn == profile.rows[0].gain_e_per_dn / 2.0
    assert true.rows[0].read_noise_e == profile.rows[0].read_noise_e * 1.5
    assert true.dark_e_per_s == profile.dark_e_per_s * 3.0
    assert true.full_well_e == profile.full_well_e * 0.5
    assert make_true_profile(profile, TrueSensor()) == profile


def test_a_truth_that_cannot_be_is_refused_before_any_device_moves(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="singular"):
        Rig(config_of(tmp_path, "[camera]\nplace = { homography = [1,0,0, 1,0,0, 0,0,1] }\n"))
    with pytest.raises(ConfigError, match="no such key"):
        Rig(config_of(tmp_path, "[camera]\nplaces = 1\n"))


def test_the_grid_of_codes_is_the_schedules_where_it_says_one() -> None:
    config = Config(scene=SceneConfig(grid=GRID))
    assert Rig(config).grid == GRID
    finer = msgspec.structs.replace(config, schedule=ScheduleConfig(grid=(12, 16)))
    assert Rig(finer).grid == (12, 16)
    assert MockBench.of(Rig(finer)._context).frame == (12, 16)


def test_a_placed_bench_takes_photos_where_the_camera_looks() -> None:
    config = Config(
        projector=PanelConfig(size_px=(64, 48)),
        mask=PanelConfig(size_px=(80, 60)),
        scene=SceneConfig(grid=GRID, ambient=1.0),
        camera=CameraConfig(noise="none", frame_quads=(16, 12), place=Placing(scale=2.0)),
    )
    wide = msgspec.structs.replace(config, mask=msgspec.structs.replace(config.mask, contrast=4.0))
    bench = MockBench.of(DriverContext(config=wide, clock=VirtualClock()))
    bench.open_shutter(0)
    bench.close_shutter(1_000_000_000)
    light = bench.quads()[..., 0]
    np.testing.assert_allclose(light[3:9, 4:12], 0.25, rtol=1e-9)
    light[3:9, 4:12] = 0.0
    assert not light.any()  # beside the field there is no scene


@pytest.mark.parametrize("driver", ["folder", "mock"])
def test_before_a_real_camera_nobody_makes_the_mock_cameras_bench(
    tmp_path: Path, driver: str
) -> None:
    """Its map is of photos that the mock camera does not take, so that this one is refused."""
    camera = Map.filling((2136, 1424)).then(np.diag([0.9, 0.9, 1.0]))
    options = {"folder": str(tmp_path)} if driver == "folder" else {}
    config = Config(camera=CameraConfig(driver=driver, place=Placing(map=camera), options=options))
    if driver == "mock":
        with pytest.raises(ConfigError, match="2136 x 1424 pixels, this one has 64 x 48"):
            Rig(config)
    else:
        assert "optics" not in vars(MockBench.of(Rig(config)._context))


def test_room_light_that_is_switched_on_half_way(tmp_path: Path) -> None:
    """The room is as the configuration says in two exposures, and then as the truth says."""
    truth = "[mask]\ncontrast = 2.0\n[scene]\nambient = 2.0\nambient_from = 3\n"
    config = config_of(tmp_path, truth, frame_quads=(16, 12))
    bench = MockBench.of(DriverContext(config=config, clock=VirtualClock()))
    found = []
    for start in range(4):
        bench.open_shutter(start * 10_000_000_000)
        bench.close_shutter(start * 10_000_000_000 + 2_000_000_000)
        found.append(bench.quads())
    for light, room in zip(found, (0.5, 0.5, 2.0, 2.0), strict=True):
        np.testing.assert_allclose(light, 2.0 * room / 2.0, rtol=1e-9)


def test_files_that_tell_another_time(tmp_path: Path) -> None:
    """1/200 s, as a body tells that was left on it; the light is that of ten seconds."""
    truth = "[mask]\ncontrast = 2.0\n"
    bare = dark_photo(tmp_path, config_of(tmp_path, truth), "a")
    told = dark_photo(tmp_path, config_of(tmp_path, truth + "[camera]\ntagged_s = 0.005\n"), "b")
    np.testing.assert_array_equal(told, bare)
    times = [read_raw(tmp_path / f"{n}.dng", saturation_dn=1e9).exposure_s for n in "ab"]
    assert times == [pytest.approx(10.0), pytest.approx(0.005)]


def test_a_shutter_that_is_told_late_to_close(tmp_path: Path) -> None:
    truth = "[trigger]\nlag_s = 0.0\njitter_s = 0.0\nstretched = 2\nstretch = 3.5\n"
    context = DriverContext(config=config_of(tmp_path, truth), clock=VirtualClock())
    shutter, bench, clock = MockShutter.create(context), MockBench.of(context), context.clock
    found = []
    for _ in range(3):
        open_ns = clock.now_ns()
        shutter.open()
        clock.sleep_until_ns(open_ns + 2_000_000_000)
        told_ns = shutter.close()
        assert bench.close_ns is not None and bench.open_ns == open_ns
        assert told_ns == bench.close_ns + context.config.trigger.sure_ns
        found.append((bench.close_ns - open_ns) * 1e-9)
    assert found == [pytest.approx(2.0), pytest.approx(7.0), pytest.approx(2.0)]
