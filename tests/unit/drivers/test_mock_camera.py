"""The mock camera: what its samples are of, what it says of itself, and when a photo is there."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mock.bench import MockBench
from drivers.mock.camera import BenchSensor, MockReadout
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import CameraConfig, Config, PanelConfig, SceneConfig
from pdcd.errors import ConfigError, ExposureError
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import read_raw

GRID = (3, 4)

SECONDS = 4

CONTRAST = 4.0

RESPONSIVITY = (3000.0, 6000.0, 1500.0)

SETTINGS = CameraSettings(iso=100, f_number=2.0)


class Rig:
    """A mock camera before a black mask that leaks a quarter of the ambient light."""

    def __init__(self, **camera: Any) -> None:
        given = {"noise": "none", "responsivity_e": RESPONSIVITY, **camera}
        self.clock = VirtualClock()
        config = Config(
            projector=PanelConfig(size_px=(64, 48)),
            mask=PanelConfig(size_px=(80, 60), contrast=CONTRAST),
            scene=SceneConfig(grid=GRID, ambient=1.0),
            camera=CameraConfig(**given),
        )
        self.context = DriverContext(config=config, clock=self.clock)
        self.bench = MockBench.of(self.context)
        self.readout = MockReadout.create(self.context)

    def expose(self) -> None:
        self.bench.open_shutter(0)
        self.bench.close_shutter(SECONDS * 10**9)

    def planes(self, path: Path) -> NDArray[np.floating]:
        return read_raw(path, saturation_dn=1e9).planes


def test_samples_are_the_light_of_their_colour_at_the_lens(tmp_path: Path) -> None:
    """Of 1 scene unit a second for 4 s, a quarter of it, at f/2; RGGB."""
    rig = Rig()
    rig.readout.arm(SETTINGS)
    rig.expose()
    before_ns = rig.clock.now_ns()
    raw = rig.readout.fetch(tmp_path, "shot", 1.0)
    assert rig.clock.now_ns() == before_ns + 200_000_000  # the file takes a moment
    assert raw.path == tmp_path / "shot.dng" and raw.second is None
    data = raw.path.read_bytes()
    assert (raw.size_bytes, raw.sha256) == (len(data), hashlib.sha256(data).hexdigest())
    frame = read_raw(raw.path, saturation_dn=1e9)
    assert (frame.exposure_s, frame.iso, frame.f_number) == (4.0, 100, 2.0)
    profile = load_profile(CameraConfig().profile)
    assert frame.model == f"pdcd mock {profile.name}"
    gain = profile.row(100).gain_e_per_dn
    red, green, blue = (value * SECONDS / CONTRAST / 4.0 / gain for value in RESPONSIVITY)
    for plane, level in zip(frame.planes, (red, green, green, blue), strict=True):
        assert plane.shape == GRID
        np.testing.assert_allclose(plane, level, atol=0.51)


def test_settings_that_the_camera_lacks_are_refused() -> None:
    rig = Rig()
    with pytest.raises(ConfigError, match=r"no ring to leave alone \(set f_number"):
        rig.readout.arm(CameraSettings(100, None))
    with pytest.raises(ConfigError, match="ISO"):
        rig.readout.arm(CameraSettings(123456, 2.0))
    with pytest.raises(ConfigError, match=r"\[camera\.options\] port: the driver mock has no"):
        Rig(options={"port": "x"})


def test_a_sensor_of_two_buckets_makes_two_files_of_one_exposure(tmp_path: Path) -> None:
    rig = Rig(buckets=2)
    rig.readout.arm(SETTINGS)
    rig.expose()
    raw = rig.readout.fetch(tmp_path, "shot", 1.0)
    assert raw.second is not None
    assert (raw.path.name, raw.second.path.name) == ("shot.dng", "shot-second.dng")
    assert not rig.bench.second
    with pytest.raises(ExposureError):
        rig.bench.exposed_ns()
    assert raw.second.size_bytes == raw.second.path.stat().st_size


def test_a_file_tells_how_the_camera_sees_white(tmp_path: Path) -> None:
    rig = Rig()
    rig.expose()
    path = tmp_path / "a.dng"
    sensor = BenchSensor(rig.bench, CameraConfig(noise="none", responsivity_e=RESPONSIVITY))
    path.write_bytes(sensor.dng(100, 2.0))
    neutral = bytes.fromhex("01000000 02000000 01000000 01000000 01000000 04000000")
    assert neutral in path.read_bytes()  # 1/2, 1, 1/4 of the strongest, as rationals


@pytest.mark.parametrize(("noise", "differ"), [("none", False), ("full", True)])
def test_noise_is_drawn_anew_for_each_photo_and_the_same_for_a_seed(
    tmp_path: Path, noise: str, differ: bool
) -> None:
    def photos(seed: int) -> list[NDArray[np.floating]]:
        rig = Rig(noise=noise, seed=seed)
        found = []
        for name in "ab":
            rig.readout.arm(SETTINGS)
            rig.expose()
            raw = rig.readout.fetch(tmp_path, f"{name}-{seed}-{noise}", 1.0)
            found.append(rig.planes(raw.path))
        return found

    first, second = photos(1)
    again, _ = photos(1)
    other, _ = photos(2)
    np.testing.assert_array_equal(first, again)
    assert bool((first != second).any()) == differ == bool((first != other).any())
