"""One open camera of libgphoto2: its settings, events and files, and what it lacks."""

from __future__ import annotations

import pytest

pytest.importorskip("gphoto2", reason="gphoto2 IS MISSING: see .venv/gphoto2.log")

import logging
import os
from pathlib import Path
from typing import Any

import gphoto2 as gp
import msgspec
import pytest

from drivers.gphoto.session import CameraFile, GphotoOptions, GphotoSession
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import CameraConfig, Config, RigConfig, TriggerConfig
from pdcd.errors import ConfigError, DeviceLost
from tests.fake_gphoto import Setting, failure
from tests.gphoto_bench import MS, Bench, Camera


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Bench:
    return Bench(monkeypatch, tmp_path)


def test_a_camera_that_is_gone_is_let_go(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    bench.session.open("a")
    bench.camera.broken = failure(gp.GP_ERROR_IO)
    with caplog.at_level(logging.WARNING):
        bench.session.close("a")
    assert "not closed in order" in caplog.text and not bench.session.is_open


class Listed:
    """A list of ports or models of libgphoto2: of no use before it is loaded."""

    def __init__(self) -> None:
        self.loaded = False

    def load(self) -> None:
        self.loaded = True

    def find(self, name: str) -> str:
        assert self.loaded
        return name

    lookup_path = lookup_model = find

    def __getitem__(self, name: str) -> str:
        return f"entry of {name}"


def test_port_and_model_are_looked_up_before_the_camera_is_opened(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bench = Bench(monkeypatch, tmp_path, port="ptpip:192.168.1.2", model="PTP/IP Camera")
    monkeypatch.setattr(gp, "PortInfoList", Listed)
    monkeypatch.setattr(gp, "CameraAbilitiesList", Listed)
    done: list[object] = []
    camera: Any = bench.camera
    camera.set_port_info = lambda entry: done.append(entry)
    camera.set_abilities = lambda entry: done.append(entry)
    monkeypatch.setattr(Camera, "init", lambda self: done.append("init"))
    assert bench.shutter.connect()["port"] == "ptpip:192.168.1.2"
    assert done == ["entry of ptpip:192.168.1.2", "entry of PTP/IP Camera", "init"]


def test_choices_are_those_of_lists_and_menus_alone(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.session.open("a")
    kinds = [gp.GP_WIDGET_RADIO, gp.GP_WIDGET_MENU, gp.GP_WIDGET_TEXT, gp.GP_WIDGET_RANGE]
    found = []
    for kind in kinds:
        monkeypatch.setattr(Setting, "get_type", lambda self, kind=kind: kind)
        found.append(bench.session.choices("iso"))
    assert found == [["Auto", "100", "200"]] * 2 + [[]] * 2
    assert bench.session.choices("none such") == []


def test_a_setting_is_what_the_camera_offers(bench: Bench) -> None:
    bench.session.open("a")
    with pytest.raises(ConfigError, match=r"iso 50 is not offered .*Auto, 100, 200"):
        bench.session.set("iso", "50")
    bench.session.set("iso", "200")
    bench.session.set("bulb", 1)  # a switch has no list
    assert (bench.session.get("iso"), bench.session.get("bulb")) == ("200", "1")
    bench.session.prefer("iso", "AUTO")
    bench.session.prefer("iso", "800")
    bench.session.prefer("none such", "800")
    assert bench.camera.written == [("iso", "200"), ("bulb", 1), ("iso", "Auto")]


@pytest.mark.parametrize(
    ("code", "becomes", "words"),
    [
        (gp.GP_ERROR_BAD_PARAMETERS, ConfigError, "no setting iso .*list-config"),
        (gp.GP_ERROR_NOT_SUPPORTED, ConfigError, "no setting iso"),
        (gp.GP_ERROR_IO, DeviceLost, "cannot read iso: .*off and on"),
        (gp.GP_ERROR_CAMERA_BUSY, DeviceLost, "cannot read iso: .*written its pictures"),
        (gp.GP_ERROR_UNKNOWN_PORT, DeviceLost, "list-ports"),
    ],
)
def test_a_setting_that_cannot_be_read_says_why(
    bench: Bench, code: int, becomes: type[Exception], words: str
) -> None:
    bench.session.open("a")
    bench.camera.broken = failure(code)
    with pytest.raises(becomes, match=words):
        bench.session.get("iso")


@pytest.mark.parametrize(("wait_s", "ms"), [(0.0104, 10), (0.0, 1)])
def test_a_picture_is_waited_for_in_whole_milliseconds(
    bench: Bench, wait_s: float, ms: int
) -> None:
    bench.session.open("a")
    bench.signs = 0
    assert bench.session.next_file(wait_s) is None
    assert (bench.camera.waits_ms, bench.signs) == ([ms], 1)
    bench.camera.add("a.cr2", b"x")
    assert bench.session.next_file(wait_s) == CameraFile("/", "a.cr2")
    bench.camera.events.append((gp.GP_EVENT_CAPTURE_COMPLETE, None))
    assert bench.session.next_file(wait_s) is None


def test_all_that_waits_is_heard_until_the_camera_is_quiet(bench: Bench) -> None:
    bench.session.open("a")
    bench.camera.add("a.cr2", b"x")
    bench.camera.events.append((gp.GP_EVENT_CAPTURE_COMPLETE, None))
    bench.camera.add("b.cr2", b"x")
    before_ns, bench.signs = bench.clock.now_ns(), 0
    found = bench.session.drain(5.0)
    assert found == [CameraFile("/", "a.cr2"), CameraFile("/", "b.cr2")]
    assert bench.camera.waits_ms == [50] * 4 and bench.signs == 4
    assert bench.clock.now_ns() == before_ns + 50 * MS


def test_a_download_is_a_sign_of_life(bench: Bench) -> None:
    bench.session.open("a")
    bench.camera.files["a.cr2"], bench.signs = b"abc", 0
    assert bench.session.download(CameraFile("/store", "a.cr2"), 3) == b"abc"
    assert bench.signs == 1
    bench.camera.broken = failure(gp.GP_ERROR_IO)
    with pytest.raises(DeviceLost, match=r"cannot download a\.cr2"):
        bench.session.download(CameraFile("/store", "a.cr2"), 3)


def test_standard_input_is_what_it_was_whatever_the_library_closes(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").write_bytes(b"x")
    kept = os.dup(0)
    file = os.open(tmp_path / "file", os.O_RDONLY)
    try:
        os.dup2(file, 0)
        before = set(Path("/proc/self/fd").iterdir())
        for name in ("init", "exit"):
            monkeypatch.setattr(Camera, name, lambda self: os.close(0))
        bench.session.open("a")
        assert os.fstat(0).st_ino == os.fstat(file).st_ino
        bench.session.close("a")
        assert os.fstat(0).st_ino == os.fstat(file).st_ino
        assert len(set(Path("/proc/self/fd").iterdir()) ^ before) == 0
        taken = os.pipe()  # by another thread in the meantime: it stays there
        monkeypatch.setattr(Camera, "init", lambda self: os.dup2(taken[0], 0))
        bench.session.open("a")
        assert os.fstat(0).st_ino == os.fstat(taken[0]).st_ino
        bench.session.close("a")
        os.dup2(file, 0)
        for end in taken:
            os.close(end)
        os.close(0)  # closed before: there is nothing to keep
        before = set(Path("/proc/self/fd").iterdir())
        monkeypatch.setattr(Camera, "init", lambda self: None)
        bench.session.open("a")
        monkeypatch.setattr(Camera, "exit", lambda self: None)
        bench.session.close("a")
        assert len(set(Path("/proc/self/fd").iterdir()) ^ before) == 0
    finally:
        os.dup2(kept, 0)
        os.close(kept)
        os.close(file)


def test_options_of_the_trigger_count_where_it_alone_is_this_driver() -> None:
    config = Config(
        rig=RigConfig(clock="real"),
        camera=CameraConfig(driver="folder", options={"folder": "/x"}),
        trigger=TriggerConfig(driver="gphoto2", options={"port": "usb:001,004"}),
    )
    session = GphotoSession.of(DriverContext(config=config, clock=VirtualClock()))
    assert session.options == GphotoOptions(port="usb:001,004", model="", destination="ram")
    wrong = msgspec.structs.replace(
        config, trigger=TriggerConfig(driver="gphoto2", options={"prt": 1})
    )
    with pytest.raises(ConfigError, match=r"trigger\.options.*prt"):
        GphotoSession.of(DriverContext(config=wrong, clock=VirtualClock()))


@pytest.mark.parametrize(
    ("code", "hint"),
    [
        (gp.GP_ERROR_IO_USB_CLAIM, "gio mount"),
        (gp.GP_ERROR_MODEL_NOT_FOUND, "auto-detect"),
        (gp.GP_ERROR_IO, "off and on"),
    ],
)
def test_a_camera_that_does_not_open_says_what_to_do(bench: Bench, code: int, hint: str) -> None:
    bench.camera.broken = failure(code)
    with pytest.raises(DeviceLost, match=hint):
        bench.session.open("a")
    bench.session.close("a")
