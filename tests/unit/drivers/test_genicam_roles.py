"""Which roles go together, options, the library's places, and what the doctor says; no camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivers.genicam import doctor, library
from drivers.genicam.aravis import FoundCamera
from drivers.genicam.device import find_camera
from drivers.genicam.options import read_genicam_options
from pdcd.bench.clock import VirtualClock
from pdcd.bench.registry import describe_drivers, load_driver
from pdcd.bench.tables import CameraConfig, Config, RigConfig, TriggerConfig
from pdcd.driver import ConfigError, DeviceLost, DriverContext, DriverUnavailable
from tests.genicam_rig import needs_aravis

OTHER = "genicam"


def context(
    camera: str,
    trigger: str,
    options: dict[str, Any] | None = None,
    beside: dict[str, Any] | None = None,
) -> DriverContext:
    config = Config(
        rig=RigConfig(clock="real"),
        camera=CameraConfig(driver=camera, options=options or {}),
        trigger=TriggerConfig(driver=trigger, options=beside or {}),
    )
    return DriverContext(config=config, clock=VirtualClock())


@needs_aravis
@pytest.mark.parametrize(("camera", "trigger", "options", "roles", "wrong"), [
    ("genicam", "genicam", {}, "both", None),
    ("genicam", "genicam", {"exposure": "edge"}, "both", None),
    ("genicam", "serial", {"exposure": "width"}, "readout", None),
    ("genicam", "serial", {}, "readout", "trigger.driver = 'genicam'"),
    ("folder", "genicam", {}, "shutter", "camera.driver = 'genicam'"),
    ("genicam", "genicam", {"exposure": "width"}, "shutter", "'serial'"),
])  # fmt: skip
def test_who_goes_with_whom(
    camera: str, trigger: str, options: dict[str, Any], roles: str, wrong: str | None
) -> None:
    bench = context(camera, trigger, options)
    wanted = ("shutter", "readout") if roles == "both" else (roles,)
    made = []
    for role in wanted:
        driver = load_driver("shutter" if role == "shutter" else "readout", OTHER)
        if wrong is None:
            made.append(driver.create(bench))
        else:
            with pytest.raises(ConfigError) as told:
                driver.create(bench)
            assert wrong in str(told.value)
    if len(made) == 2:
        assert made[0]._camera is made[1]._camera


@pytest.mark.parametrize(("options", "word"), [
    ({"camra": "1"}, "camra"), ({"exposure": "bulb"}, "exposure"), ({"margin_s": -1.0}, "margin_s"),
    ({"packet_bytes": 100}, "packet_bytes"), ({"wait_s": 0.0}, "wait_s"),
    ({"unplanned_s": 0.0}, "unplanned_s"), ({"white_dn": 70000}, "white_dn"),
])  # fmt: skip
def test_options_that_are_wrong_are_named(options: dict[str, Any], word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        read_genicam_options(context("genicam", "genicam", options).config)


def test_options_are_given_once() -> None:
    one = context("genicam", "genicam", {"camera": "A"}, {"margin_s": 0.2}).config
    assert read_genicam_options(one).camera == "A" and read_genicam_options(one).margin_s == 0.2
    two = context("genicam", "genicam", {"camera": "A"}, {"camera": "B"}).config
    with pytest.raises(ConfigError, match="camera"):
        read_genicam_options(two)


CAMERAS = [
    FoundCamera("Basler-21", "Basler", "a2A", "21", "10.0.0.2", "GigEVision"),
    FoundCamera("FLIR-22", "FLIR", "BFS", "22", "USB3", "USB3Vision"),
]


@pytest.mark.parametrize(("wanted", "there", "found"), [
    (None, CAMERAS[:1], "Basler-21"), ("22", CAMERAS, "FLIR-22"), ("FLIR-22", CAMERAS, "FLIR-22"),
    ("10.0.0.9", [], "10.0.0.9"),  # an address is asked, whoever announces himself
    (None, [], DeviceLost), ("23", CAMERAS, DeviceLost), (None, CAMERAS, ConfigError),
])  # fmt: skip
def test_the_camera_that_is_meant_is_found(
    wanted: str | None, there: list[FoundCamera], found: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.genicam.device.list_cameras", lambda: there)
    if isinstance(found, str):
        assert find_camera(wanted) == found
        return
    with pytest.raises(found) as told:
        find_camera(wanted)
    for camera in there:
        assert camera.serial in str(told.value)


@pytest.fixture
def _nowhere(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A machine without the library."""
    monkeypatch.setattr(library, "list_libraries", lambda: ("/nowhere/libaravis.so",))
    library.load_library.cache_clear()
    yield
    library.load_library.cache_clear()


@pytest.mark.usefixtures("_nowhere")
def test_without_the_library_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.delitem(sys.modules, "drivers.genicam.roles", raising=False)
    with pytest.raises(DriverUnavailable) as told:
        load_driver("readout", "genicam")
    assert "libaravis-0.8-0" in str(told.value) and "aravis-python" in str(told.value)
    assert told.value.hint is not None and "install aravis-python" in told.value.hint
    monkeypatch.delitem(sys.modules, "drivers.genicam.roles", raising=False)
    (row,) = (r for r in describe_drivers() if (r["role"], r["name"]) == ("shutter", "genicam"))
    assert not row["available"] and "libaravis" in str(row["reason"])
    (finding,) = doctor.examine_genicam(context("genicam", "genicam"))
    assert finding.state == "fault" and "libaravis" in finding.found


def test_the_wheel_is_taken_before_what_the_system_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside = tmp_path / "aravis" / "lib"
    inside.mkdir(parents=True)
    (tmp_path / "aravis" / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    system = library.SONAME
    assert library.list_libraries()[-1] == system
    assert str(inside / system) not in library.list_libraries()  # somebody else's `aravis`
    (inside / system).touch()
    assert library.list_libraries() == (str(inside / system), system)
