"""The gphoto2 drivers on a camera that exists only here: settings, files, and what goes wrong.

How libgphoto2 itself behaves is not tested here.
"""

from __future__ import annotations

import errno
import hashlib
import itertools
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest

pytest.importorskip("gphoto2", reason="gphoto2 IS MISSING: see .venv/gphoto2.log")

import gphoto2 as gp

from drivers.gphoto import GphotoReadout, GphotoShutter
from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import CameraConfig, Config, RigConfig, TriggerConfig
from pdcd.errors import ConfigError, DecodeError, DeviceLost, DiskError, ExposureError, NoSpaceError
from pdcd.sensor.raw import read_raw
from tests.cr2 import write_cr2
from tests.fake_gphoto import FakeCamera, Setting, failure

SETTINGS = CameraSettings(iso=100, f_number=None)


class FastClock(VirtualClock):
    """Looking at it takes a tenth of a second, so that waits for events end."""

    def now_ns(self) -> int:
        self.sleep_until_ns(super().now_ns() + 100_000_000)
        return super().now_ns()


def settings() -> dict[str, Setting]:
    return {
        "cameramodel": Setting("Canon EOS 450D"),
        "serialnumber": Setting("123"),
        "iso": Setting("Auto", ("Auto", "100", "200", "400")),
        "shutterspeed": Setting("1/60", ("bulb", "30", "1/60")),
        "aperture": Setting("implicit auto", ("implicit auto", "5.6", "8", "11")),
        "imageformat": Setting("L", ("L", "RAW + L", "RAW")),
        "capturetarget": Setting("Memory card", ("Internal RAM", "Memory card")),
        "bulb": Setting(0),
    }


class Bench:
    def __init__(self, monkeypatch: pytest.MonkeyPatch, root: Path, **options: Any) -> None:
        self.camera = FakeCamera(settings())
        monkeypatch.setattr(gp, "Camera", lambda: self.camera)
        self.config = Config(
            rig=RigConfig(clock="real"),
            camera=CameraConfig(
                driver="gphoto2", responsivity_e=(1.0, 2.0, 3.0), options=dict(options)
            ),
            trigger=TriggerConfig(driver="gphoto2", lag_s=0.0, jitter_s=0.0),
        )
        self.clock = FastClock()
        context = DriverContext(config=self.config, clock=self.clock)
        self.shutter, self.readout = GphotoShutter.create(context), GphotoReadout.create(context)
        self.root = root
        write_cr2(root / "source.cr2", np.full((64, 96), 2000, np.uint16))
        self.raw = (root / "source.cr2").read_bytes()

    def connect(self) -> None:
        self.shutter.connect()
        self.readout.connect()
        self.readout.arm(SETTINGS)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Bench:
    return Bench(monkeypatch, tmp_path)


def test_one_session_for_both_roles(bench: Bench) -> None:
    bench.shutter.connect()
    info = bench.readout.connect()
    assert bench.camera.opened == 1
    assert (info.model, info.serial) == ("Canon EOS 450D", "123")
    assert (info.isos, info.f_numbers) == ((100, 200, 400), (5.6, 8.0, 11.0))
    bench.shutter.disconnect()
    assert bench.camera.opened == 1
    bench.readout.disconnect()
    bench.readout.disconnect()
    assert bench.camera.opened == 0


def test_an_exposure(bench: Bench) -> None:
    bench.connect()
    bench.readout.arm(CameraSettings(iso=400, f_number=8.0))
    values = {name: setting.value for name, setting in bench.camera.settings.items()}
    assert values["iso"] == "400"
    assert values["aperture"] == "8"
    assert values["shutterspeed"] == "bulb"
    assert values["imageformat"] == "RAW"
    assert values["capturetarget"] == "Internal RAM"
    bench.shutter.open()
    assert bench.camera.settings["bulb"].value == 1
    bench.shutter.close()
    assert bench.camera.settings["bulb"].value == 0
    bench.camera.add("capt0000.cr2", bench.raw)
    raw = bench.readout.fetch(bench.root, "shot", 30.0)
    assert raw.path == bench.root / "shot.cr2"
    assert raw.path.read_bytes() == bench.raw
    assert (raw.size_bytes, raw.sha256) == (len(bench.raw), hashlib.sha256(bench.raw).hexdigest())
    assert read_raw(raw.path).model == "Canon EOS 450D"


def test_the_card_if_asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bench = Bench(monkeypatch, tmp_path, destination="card")
    bench.connect()
    assert bench.camera.settings["capturetarget"].value == "Memory card"


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (CameraSettings(50, None), r"ISO 50 is not offered .*100, 200, 400"),
        (CameraSettings(100, 6.3), r"f/6.3 is not offered .*5.6, 8, 11"),
    ],
)
def test_what_the_camera_lacks_is_refused_with_its_list(
    bench: Bench, wanted: CameraSettings, message: str
) -> None:
    bench.connect()
    with pytest.raises(ConfigError, match=message):
        bench.readout.arm(wanted)
    with pytest.raises(ExposureError, match="arm"):
        bench.readout.fetch(bench.root, "shot", 1.0)


def test_a_manual_lens_has_no_apertures(bench: Bench) -> None:
    del bench.camera.settings["aperture"]
    bench.shutter.connect()
    assert bench.readout.connect().f_numbers == ()
    bench.readout.arm(CameraSettings(100, 8.0))


def test_a_camera_without_bulb_needs_another_trigger(bench: Bench) -> None:
    del bench.camera.settings["bulb"]
    with pytest.raises(ConfigError, match="no setting bulb"):
        bench.shutter.connect()


def test_a_file_told_of_twice_is_fetched_once(bench: Bench) -> None:
    bench.connect()
    bench.camera.add("a.cr2", bench.raw, times=2)
    bench.readout.fetch(bench.root, "shot", 30.0)
    assert bench.camera.fetched == ["a.cr2"]


def test_a_jpeg_beside_it_is_thrown_away(bench: Bench) -> None:
    bench.connect()
    bench.camera.add("a.jpg", b"\xff\xd8")
    bench.camera.add("a.cr2", bench.raw)
    assert bench.readout.fetch(bench.root, "shot", 30.0).path.suffix == ".cr2"
    assert bench.camera.fetched == ["a.jpg", "a.cr2"]


def test_two_raw_files_are_refused(bench: Bench) -> None:
    bench.connect()
    bench.camera.add("a.cr2", bench.raw)
    bench.camera.add("b.cr2", bench.raw)
    with pytest.raises(ExposureError, match="2 RAW files"):
        bench.readout.fetch(bench.root, "shot", 30.0)


@pytest.mark.parametrize(("others", "message"), [((), "5 s "), (("a.jpg",), r"only a\.jpg")])
def test_no_file_ends_in_time(bench: Bench, others: tuple[str, ...], message: str) -> None:
    bench.connect()
    for name in others:
        bench.camera.add(name, b"\xff\xd8")
    before = bench.clock.now_ns()
    with pytest.raises(ExposureError, match=message):
        bench.readout.fetch(bench.root, "shot", 5.0)
    assert (bench.clock.now_ns() - before) * 1e-9 < 6.0


def test_a_late_file_of_an_earlier_exposure_is_not_taken_for_this_one(bench: Bench) -> None:
    bench.connect()
    bench.camera.add("old.cr2", b"old")
    bench.readout.arm(SETTINGS)
    bench.camera.add("new.cr2", bench.raw)
    assert bench.readout.fetch(bench.root, "shot", 30.0).size_bytes == len(bench.raw)
    assert bench.camera.fetched == ["old.cr2", "new.cr2"]


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_truncated_file_is_refused(bench: Bench, share: float) -> None:
    bench.connect()
    bench.camera.add("a.cr2", bench.raw[: int(len(bench.raw) * share)])
    with pytest.raises(DecodeError, match="not whole"):
        bench.readout.fetch(bench.root, "shot", 30.0)
    assert not (bench.root / "shot.cr2").exists()


class Refused:
    """An open file that takes no bytes."""

    def __init__(self, file: IO[Any], error: OSError) -> None:
        self.file, self.error = file, error

    def __enter__(self) -> Refused:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def write(self, data: bytes) -> int:
        raise self.error


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (OSError(errno.ENOSPC, "full"), NoSpaceError),
        (OSError(errno.EDQUOT, "full"), NoSpaceError),
        (OSError(errno.EIO, "broken"), DiskError),
    ],
)
def test_of_a_disk_that_takes_no_more_nothing_is_left_behind(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, error: OSError, told: type[Exception]
) -> None:
    """The file is there already when its bytes find no room."""
    whole_open = Path.open

    def opened(path: Path, mode: str = "r", *args: Any) -> Any:
        file = whole_open(path, mode, *args)
        return Refused(file, error) if mode == "xb" else file

    bench.connect()
    bench.camera.add("a.cr2", bench.raw)
    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(told) as caught:
        bench.readout.fetch(bench.root, "shot", 30.0)
    assert type(caught.value) is told and caught.value.__cause__ is error
    assert "shot.cr2" in str(caught.value)
    assert not (bench.root / "shot.cr2").exists()


def test_a_file_of_the_run_is_never_written_over(bench: Bench) -> None:
    (bench.root / "shot.cr2").write_bytes(b"precious")
    bench.connect()
    bench.camera.add("a.cr2", bench.raw)
    with pytest.raises(DiskError, match=r"shot\.cr2"):
        bench.readout.fetch(bench.root, "shot", 30.0)
    assert (bench.root / "shot.cr2").read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("code", "hint"),
    [
        (gp.GP_ERROR_IO_USB_CLAIM, "gio mount"),
        (gp.GP_ERROR_MODEL_NOT_FOUND, "auto-detect"),
        (gp.GP_ERROR_IO, "off and on"),
    ],
)
def test_a_camera_that_does_not_open(bench: Bench, code: int, hint: str) -> None:
    bench.camera.broken = failure(code)
    with pytest.raises(DeviceLost, match=hint):
        bench.shutter.connect()
    bench.shutter.disconnect()


def test_unplugged_during_an_exposure_is_never_called_closed(bench: Bench) -> None:
    bench.connect()
    bench.shutter.open()
    bench.camera.broken = failure(gp.GP_ERROR_IO)
    for _ in range(2):
        with pytest.raises(DeviceLost):
            bench.shutter.close()
    with pytest.raises(DeviceLost):
        bench.readout.fetch(bench.root, "shot", 5.0)
    with pytest.raises(DeviceLost):
        bench.shutter.disconnect()
    bench.readout.disconnect()


def test_an_opening_that_failed_is_not_repeated_but_ended(bench: Bench) -> None:
    bench.connect()
    bench.camera.written.clear()

    def lose_the_answer(value: int) -> None:
        if value:
            raise failure(gp.GP_ERROR_TIMEOUT)

    bench.camera.on_bulb = lose_the_answer
    with pytest.raises(DeviceLost):
        bench.shutter.open()
    bench.shutter.close()
    assert bench.camera.written == [("bulb", 1), ("bulb", 0)]


def test_an_exposure_left_running_is_ended_at_the_start(bench: Bench) -> None:
    bench.shutter.connect()
    assert bench.camera.written[-1] == ("bulb", 0)


def test_nothing_works_before_connect(bench: Bench) -> None:
    with pytest.raises(DeviceLost, match="connect first"):
        bench.shutter.open()
    with pytest.raises(ExposureError):
        bench.readout.fetch(bench.root, "shot", 1.0)
    bench.readout.disconnect()


def test_who_waits_for_a_photo_shows_that_he_lives(bench: Bench, tmp_path: Path) -> None:
    signs_ns: list[int] = []
    context = DriverContext(
        config=bench.config,
        clock=bench.clock,
        alive=lambda: signs_ns.append(VirtualClock.now_ns(bench.clock)),
    )
    readout = GphotoReadout.create(context)
    readout.connect()
    readout.arm(SETTINGS)
    with pytest.raises(ExposureError):
        readout.fetch(tmp_path, "shot", 60.0)
    readout.disconnect()
    assert signs_ns[-1] - signs_ns[0] > 55e9
    assert max(b - a for a, b in itertools.pairwise(signs_ns)) < 3e9


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (
            {
                "camera": CameraConfig(driver="gphoto2", options={"prt": "x"}),
            },
            "prt",
        ),
        (
            {
                "camera": CameraConfig(driver="gphoto2"),
                "rig": RigConfig(),
            },
            "clock",
        ),
    ],
)
def test_wrong_settings_are_refused(tables: dict[str, Any], message: str) -> None:
    config = Config(**{"rig": RigConfig(clock="real"), **tables})
    context = DriverContext(config=config, clock=RealClock())
    with pytest.raises(ConfigError, match=message):
        GphotoReadout.create(context)
