"""The gphoto2 shutter and readout on a camera that exists only here: waits, orders, and faults.

How libgphoto2 itself behaves is tested by the contract, on a virtual camera.
"""

from __future__ import annotations

import pytest

pytest.importorskip("gphoto2", reason="gphoto2 IS MISSING: see .venv/gphoto2.log")

import errno
import gc
import hashlib
from collections.abc import Callable
from pathlib import Path

import gphoto2 as gp
import pytest

from drivers.gphoto.camera import GphotoReadout
from pdcd.bench.clock import RealClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import CameraConfig, Config, RigConfig
from pdcd.errors import (
    ConfigError,
    DecodeError,
    DeviceLost,
    DiskError,
    ExposureError,
    NoSpaceError,
)
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import read_raw
from tests.fake_gphoto import Setting, failure
from tests.gphoto_bench import MS, Bench, Camera

SURE_NS = 180 * MS
"""A lag of 100 ms and four jitters of 20 ms."""

SETTINGS = CameraSettings(iso=100, f_number=None)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Bench:
    return Bench(monkeypatch, tmp_path)


@pytest.fixture
def armed(bench: Bench) -> Bench:
    bench.readout.connect()
    bench.readout.arm(SETTINGS)
    bench.camera.waits_ms.clear()
    return bench


# The shutter.


def test_a_shutter_is_ready_for_bulb_once_it_is_connected(bench: Bench) -> None:
    assert bench.shutter.connect() == {"model": "gphoto2 bulb", "port": "usb"}
    assert bench.camera.written == [("shutterspeed", "Bulb"), ("bulb", 0)]


def test_times_are_those_by_which_it_surely_moved(bench: Bench) -> None:
    bench.shutter.connect()
    before_ns = bench.clock.now_ns()
    assert bench.shutter.open() == before_ns + SURE_NS == bench.clock.now_ns()
    before_ns = bench.clock.now_ns()
    assert bench.shutter.close() == before_ns + SURE_NS == bench.clock.now_ns()
    bench.camera.written.clear()
    assert bench.shutter.close() == before_ns + SURE_NS  # closed: nothing to say or to wait for
    assert bench.camera.written == []


@pytest.mark.parametrize("ended_itself", [False, True])
def test_a_camera_that_is_there_again_has_its_exposure_ended(
    bench: Bench, ended_itself: bool
) -> None:
    """A cable with a loose contact: what was open answers no more, the camera does."""
    bench.readout.connect()
    bench.shutter.connect()
    bench.readout.arm(SETTINGS)
    bench.shutter.open()
    first, second = bench.camera, Camera(bench.clock)
    first.broken = failure(gp.GP_ERROR_IO)
    if ended_itself:
        second.refuses_bulb = failure(gp.GP_ERROR)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gp, "Camera", lambda: second)
        with pytest.raises(ExposureError, match="connection was lost while the shutter was open"):
            bench.shutter.close()
    assert (first.opened, second.opened) == (0, 1)
    assert second.written == [("bulb", 0)] * (not ended_itself)
    assert bench.shutter.close() == bench.clock.now_ns()


def test_a_camera_that_refuses_to_close_is_not_opened_again(bench: Bench) -> None:
    bench.shutter.connect()
    bench.shutter.open()
    bench.camera.refuses_bulb = failure(gp.GP_ERROR)
    for _ in range(2):
        with pytest.raises(DeviceLost, match="cannot set bulb to 0"):
            bench.shutter.close()
    assert bench.camera.opened == 1
    bench.camera.refuses_bulb = None
    bench.shutter.close()
    assert bench.camera.written[-1] == ("bulb", 0)


@pytest.mark.parametrize("refuses", [False, True])
def test_a_shutter_that_is_forgotten_ends_its_exposure(
    bench: Bench, caplog: pytest.LogCaptureFixture, refuses: bool
) -> None:
    """A thread that takes a photo dies with the interpreter, wherever it is."""
    bench.shutter.connect()
    bench.shutter.open()
    bench.camera.written.clear()
    if refuses:
        bench.camera.refuses_bulb = failure(gp.GP_ERROR)
    del bench.shutter
    gc.collect()
    assert bench.camera.written == [("bulb", 0)] * (not refuses)
    assert ("may be open" in caplog.text) == refuses


# The readout.


def test_a_camera_says_what_it_has(bench: Bench) -> None:
    info = bench.readout.connect()
    assert (info.isos, info.f_numbers) == ((100, 200), (5.6, 8.0, 11.0))
    assert (info.model, info.serial) == ("gphoto2 camera", "")  # it does not say
    profile = load_profile(CameraConfig().profile)
    assert (info.profile, info.frame_quads) == (profile.name, profile.frame_quads)
    assert tuple(info.responsivity_e) == (1.0, 2.0, 3.0)


def test_a_camera_without_isos_cannot_be_used(bench: Bench) -> None:
    bench.camera.settings["iso"] = Setting("Auto", ("Auto",))
    with pytest.raises(ConfigError, match=r"no ISO .*dial to M"):
        bench.readout.connect()


def test_pictures_from_before_are_heard_of_and_left_in_the_camera(bench: Bench) -> None:
    bench.camera.add("holiday.cr2", bench.raw)
    bench.readout.connect()
    bench.readout.arm(SETTINGS)
    assert bench.camera.fetched == []


def test_a_camera_that_never_stops_talking_is_heard_out_for_five_seconds(bench: Bench) -> None:
    for number in range(400):
        bench.camera.later(0.04 * number, f"{number}.cr2", b"x")
    before_ns = bench.clock.now_ns()
    bench.readout.connect()
    assert 5000 * MS <= bench.clock.now_ns() - before_ns < 5050 * MS
    before_ns = bench.clock.now_ns()
    bench.readout.arm(SETTINGS)
    assert 5000 * MS <= bench.clock.now_ns() - before_ns < 5050 * MS


@pytest.mark.parametrize(
    ("asked", "taken"),
    [(5.6, "f/5.6"), (5.65, "f/5.6"), (8.07, "8"), (7.93, "8"), (7.9, None), (8.11, None)],
)
def test_an_aperture_is_taken_within_a_hundredth(
    bench: Bench, asked: float, taken: str | None
) -> None:
    bench.readout.connect()
    if taken is None:
        with pytest.raises(ConfigError, match=r"is not offered .*5\.6, 8, 11"):
            bench.readout.arm(CameraSettings(100, asked))
        with pytest.raises(ExposureError, match="arm"):
            bench.readout.fetch(bench.root, "shot", 1.0)
    else:
        bench.readout.arm(CameraSettings(100, asked))
        assert bench.value("aperture") == taken


def test_events_are_waited_for_in_halves_of_a_second_up_to_the_end(armed: Bench) -> None:
    """Each wait is a sign of life."""
    before_ns, signs = armed.clock.now_ns(), armed.signs
    with pytest.raises(ExposureError, match=r"no RAW file came within 1\.2 s \(is"):
        armed.readout.fetch(armed.root, "shot", 1.2)
    assert armed.camera.waits_ms == [500, 500, 200] and armed.signs == signs + 3
    assert armed.clock.now_ns() == before_ns + 1200 * MS


def test_a_second_photo_in_that_time_is_refused_and_a_third_not_waited_for(armed: Bench) -> None:
    for at_s, name in ((0.2, "a.cr2"), (0.49, "b.cr2"), (0.7, "c.cr2")):
        armed.camera.later(at_s, name, armed.raw)
    with pytest.raises(ExposureError, match="2 RAW files"):
        armed.readout.fetch(armed.root, "shot", 60.0)
    assert not (armed.root / "shot.cr2").exists()


def test_a_raw_file_that_is_no_tiff_is_not_looked_into(armed: Bench) -> None:
    armed.camera.add("a.RAF", b"FUJIFILMCCD-RAW " * 4)
    raw = armed.readout.fetch(armed.root, "shot", 5.0)
    assert (raw.path.name, raw.size_bytes) == ("shot.raf", 64)


def test_one_session_serves_both_roles(bench: Bench) -> None:
    said = {"cameramodel": Setting("Canon EOS 450D"), "serialnumber": Setting("123")}
    bench.camera.settings |= said
    bench.shutter.connect()
    info = bench.readout.connect()
    assert bench.camera.opened == 1
    assert (info.model, info.serial) == ("Canon EOS 450D", "123")
    bench.shutter.disconnect()
    assert bench.camera.opened == 1
    for _ in range(2):
        bench.readout.disconnect()
    assert bench.camera.opened == 0
    with pytest.raises(DeviceLost, match="connect first"):
        bench.shutter.open()


def test_an_exposure(bench: Bench) -> None:
    bench.shutter.connect()
    bench.readout.connect()
    bench.readout.arm(CameraSettings(iso=200, f_number=8.0))
    wanted = {
        "iso": "200", "aperture": "8", "shutterspeed": "Bulb", "imageformat": "raw",
        "capturetarget": "Internal RAM",
    }  # fmt: skip
    assert {name: bench.value(name) for name in wanted} == wanted
    bench.shutter.open()
    assert bench.value("bulb") == 1
    bench.shutter.close()
    assert bench.value("bulb") == 0
    bench.camera.add("a.jpg", b"\xff\xd8")
    bench.camera.add("capt0000.cr2", bench.raw, times=2)
    raw = bench.readout.fetch(bench.root, "shot", 30.0)
    assert raw.path == bench.root / "shot.cr2" and raw.path.read_bytes() == bench.raw
    assert (raw.size_bytes, raw.sha256) == (len(bench.raw), hashlib.sha256(bench.raw).hexdigest())
    assert read_raw(raw.path).model == "Canon EOS 450D"
    assert bench.camera.fetched == ["a.jpg", "capt0000.cr2"]  # which was told of twice


def test_the_card_if_asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bench = Bench(monkeypatch, tmp_path, destination="card")
    bench.readout.connect()
    assert bench.value("capturetarget") == "Memory card"


def test_a_manual_lens_has_no_apertures_and_a_camera_without_bulb_no_shutter(bench: Bench) -> None:
    del bench.camera.settings["aperture"], bench.camera.settings["bulb"]
    assert bench.readout.connect().f_numbers == ()
    bench.readout.arm(CameraSettings(100, 8.0))
    with pytest.raises(ConfigError, match="no setting bulb"):
        bench.shutter.connect()


def test_a_jpeg_alone_is_no_photo(armed: Bench) -> None:
    armed.camera.add("a.jpg", b"\xff\xd8")
    with pytest.raises(ExposureError, match=r"only a\.jpg"):
        armed.readout.fetch(armed.root, "shot", 5.0)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_truncated_file_is_refused(armed: Bench, share: float) -> None:
    armed.camera.add("a.cr2", armed.raw[: int(len(armed.raw) * share)])
    with pytest.raises(DecodeError, match="not whole"):
        armed.readout.fetch(armed.root, "shot", 30.0)
    assert not (armed.root / "shot.cr2").exists()


@pytest.mark.parametrize("at_the_end", [False, True])
@pytest.mark.parametrize(
    ("error", "told"),
    [
        (OSError(errno.ENOSPC, "full"), NoSpaceError),
        (OSError(errno.EDQUOT, "full"), NoSpaceError),
        (OSError(errno.EIO, "broken"), DiskError),
    ],
)
def test_of_a_disk_that_takes_no_more_nothing_is_left_behind(
    armed: Bench,
    refuse_writes: Callable[..., None],
    error: OSError,
    told: type[Exception],
    at_the_end: bool,
) -> None:
    armed.camera.add("a.cr2", armed.raw)
    refuse_writes(error, at_the_end)
    with pytest.raises(told, match=r"shot\.cr2") as caught:
        armed.readout.fetch(armed.root, "shot", 30.0)
    assert type(caught.value) is told and caught.value.__cause__ is error
    assert not (armed.root / "shot.cr2").exists()


def test_a_file_of_the_run_is_never_written_over(armed: Bench) -> None:
    (armed.root / "shot.cr2").write_bytes(b"precious")
    armed.camera.add("a.cr2", armed.raw)
    with pytest.raises(DiskError, match=r"shot\.cr2"):
        armed.readout.fetch(armed.root, "shot", 30.0)
    assert (armed.root / "shot.cr2").read_bytes() == b"precious"


def test_unplugged_during_an_exposure_is_never_called_closed(armed: Bench) -> None:
    armed.shutter.connect()
    armed.shutter.open()
    armed.camera.broken = failure(gp.GP_ERROR_IO)
    for _ in range(2):
        with pytest.raises(DeviceLost):
            armed.shutter.close()
    with pytest.raises(DeviceLost):
        armed.readout.fetch(armed.root, "shot", 5.0)
    with pytest.raises(DeviceLost):
        armed.shutter.disconnect()
    armed.readout.disconnect()
    assert not armed.session.is_open and armed.camera.opened == 0
    armed.camera.broken = None
    before_ns = armed.clock.now_ns()
    armed.shutter.connect()  # which begins closed
    assert armed.shutter.close() == before_ns == armed.clock.now_ns()


def test_an_opening_that_failed_is_not_repeated_but_ended(bench: Bench) -> None:
    bench.shutter.connect()
    bench.camera.written.clear()

    def lose_the_answer(value: int) -> None:
        if value:
            raise failure(gp.GP_ERROR_TIMEOUT)

    bench.camera.on_bulb = lose_the_answer
    with pytest.raises(DeviceLost):
        bench.shutter.open()
    bench.shutter.close()
    assert bench.camera.written == [("bulb", 1), ("bulb", 0)]


@pytest.mark.parametrize(
    ("camera", "rig", "message"),
    [
        (CameraConfig(driver="gphoto2", options={"prt": "x"}), RigConfig(clock="real"), "prt"),
        (CameraConfig(driver="gphoto2"), RigConfig(), "clock"),
    ],
)
def test_wrong_settings_are_refused(camera: CameraConfig, rig: RigConfig, message: str) -> None:
    context = DriverContext(config=Config(rig=rig, camera=camera), clock=RealClock())
    with pytest.raises(ConfigError, match=message):
        GphotoReadout.create(context)
