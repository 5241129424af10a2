"""The gphoto2 shutter and readout to the millisecond: waits, orders, and what is refused."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("gphoto2", reason="gphoto2 IS MISSING: see .venv/gphoto2.log")

import gphoto2 as gp

from drivers.gphoto.camera import GphotoReadout, GphotoShutter
from pdcd.bench.devices import CameraSettings
from pdcd.bench.tables import CameraConfig
from pdcd.errors import ConfigError, DeviceLost, DiskError, ExposureError
from pdcd.sensor.profile import load_profile
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


def test_a_camera_may_refuse_to_end_what_has_not_begun(bench: Bench) -> None:
    bench.camera.refuses_bulb = failure(gp.GP_ERROR)
    bench.shutter.connect()
    bench.camera.refuses_bulb = None
    assert bench.shutter.open() > 0


def test_times_are_those_by_which_it_surely_moved(bench: Bench) -> None:
    bench.shutter.connect()
    before_ns = bench.clock.now_ns()
    assert bench.shutter.open() == before_ns + SURE_NS == bench.clock.now_ns()
    before_ns = bench.clock.now_ns()
    assert bench.shutter.close() == before_ns + SURE_NS == bench.clock.now_ns()
    bench.camera.written.clear()
    assert bench.shutter.close() == before_ns + SURE_NS  # closed: nothing to say or to wait for
    assert bench.camera.written == []


def test_a_camera_lost_in_an_exposure_is_let_go_and_begins_closed(bench: Bench) -> None:
    bench.shutter.connect()
    bench.shutter.open()
    bench.camera.broken = failure(gp.GP_ERROR_IO)
    with pytest.raises(DeviceLost, match=r"cannot (set bulb to 0|read bulb)"):
        bench.shutter.disconnect()
    assert not bench.session.is_open and bench.camera.opened == 0
    bench.camera.broken = None
    before_ns = bench.clock.now_ns()
    assert bench.shutter.close() == before_ns
    bench.shutter.connect()
    assert bench.shutter.close() == before_ns == bench.clock.now_ns()


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


def test_a_camera_that_was_switched_off_and_on_is_found_by_the_next_exposure(bench: Bench) -> None:
    bench.readout.connect()
    bench.camera.broken = failure(gp.GP_ERROR_IO_WRITE)
    for _ in range(2):
        with pytest.raises(DeviceLost):
            bench.readout.arm(SETTINGS)
    with pytest.MonkeyPatch.context() as patch:
        another = Camera(bench.clock)  # what was open stays broken
        patch.setattr(gp, "Camera", lambda: another)
        bench.readout.arm(SETTINGS)
    assert another.settings["capturetarget"].value == "Internal RAM"
    another.add("a.cr2", bench.raw)
    bench.readout.fetch(bench.root, "shot", 5.0)


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


def test_a_second_connect_ends_an_exposure(bench: Bench) -> None:
    bench.shutter.connect()
    bench.shutter.open()
    bench.shutter.connect()
    assert bench.camera.written[-1] == ("bulb", 0) and bench.camera.opened == 1
    before_ns = bench.clock.now_ns()
    assert bench.shutter.close() == before_ns == bench.clock.now_ns()


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


def test_a_camera_without_a_choice_of_places_keeps_its_own(bench: Bench) -> None:
    del bench.camera.settings["capturetarget"]
    bench.readout.connect()
    assert bench.camera.written == []


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


def test_a_camera_on_a_cable_release_is_set_for_bulb_and_raw(armed: Bench) -> None:
    assert (armed.value("shutterspeed"), armed.value("imageformat")) == ("Bulb", "raw")
    assert (armed.value("iso"), armed.value("aperture")) == ("100", "8")


@pytest.mark.parametrize(
    ("asked", "taken"),
    [(5.6, "f/5.6"), (5.65, "f/5.6"), (8.0, "8"), (8.07, "8"), (7.93, "8"), (11.1, "11")],
)
def test_an_aperture_is_taken_within_a_hundredth(bench: Bench, asked: float, taken: str) -> None:
    bench.readout.connect()
    bench.readout.arm(CameraSettings(100, asked))
    assert bench.value("aperture") == taken


@pytest.mark.parametrize("asked", [7.9, 8.11, 5.5, 5.7, 1.0, 22.0])
def test_another_aperture_is_refused(bench: Bench, asked: float) -> None:
    bench.readout.connect()
    with pytest.raises(ConfigError, match=r"is not offered .*5\.6, 8, 11"):
        bench.readout.arm(CameraSettings(100, asked))
    with pytest.raises(ExposureError, match="arm"):
        bench.readout.fetch(bench.root, "shot", 1.0)


def test_events_are_waited_for_in_halves_of_a_second_up_to_the_end(armed: Bench) -> None:
    before_ns = armed.clock.now_ns()
    with pytest.raises(ExposureError, match=r"no RAW file came within 1\.2 s \(is"):
        armed.readout.fetch(armed.root, "shot", 1.2)
    assert armed.camera.waits_ms == [500, 500, 200]
    assert armed.clock.now_ns() == before_ns + 1200 * MS


def test_after_a_photo_a_second_one_is_listened_for_three_tenths_of_a_second(armed: Bench) -> None:
    armed.camera.later(0.2, "A.CR2", armed.raw)
    armed.camera.later(0.51, "B.CR2", armed.raw)  # too late to be of this exposure
    before_ns = armed.clock.now_ns()
    raw = armed.readout.fetch(armed.root, "shot", 60.0)
    assert raw.path == armed.root / "shot.cr2"
    assert armed.clock.now_ns() == before_ns + 500 * MS
    assert armed.camera.asked_for == [("/store", "A.CR2", gp.GP_FILE_TYPE_NORMAL)]


def test_a_second_photo_in_that_time_is_refused_and_a_third_not_waited_for(armed: Bench) -> None:
    for at_s, name in ((0.2, "a.cr2"), (0.49, "b.cr2"), (0.7, "c.cr2")):
        armed.camera.later(at_s, name, armed.raw)
    with pytest.raises(ExposureError, match="2 RAW files"):
        armed.readout.fetch(armed.root, "shot", 60.0)
    assert not (armed.root / "shot.cr2").exists()


@pytest.mark.parametrize(
    ("late_s", "waited_s"),
    [
        (0.0, 0.05),  # it waits already
        (2.0, 2.0),
        (24.0, 24.0),  # noise reduction takes the exposure once more
        (None, 25.0),
    ],
)
def test_the_photo_of_an_exposure_that_was_given_up_is_not_taken_for_the_next(
    bench: Bench, late_s: float | None, waited_s: float
) -> None:
    """A job is cancelled in its exposure of 10 s, and the next one begins at once."""
    bench.readout.connect()
    bench.shutter.connect()
    bench.readout.arm(SETTINGS)
    bench.shutter.open()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000 * MS - SURE_NS)
    bench.shutter.close()
    if late_s is not None:
        bench.camera.later(max(0.0, late_s - 0.18), "given-up.cr2", b"II*\0")
    before_ns = bench.clock.now_ns()
    bench.readout.arm(SETTINGS)
    assert bench.clock.now_ns() - before_ns == pytest.approx((waited_s - 0.18) * 1e9, abs=3e8)
    bench.shutter.open()
    bench.shutter.close()
    bench.camera.later(1.0, "next.cr2", bench.raw)
    raw = bench.readout.fetch(bench.root, "shot", 60.0)
    assert raw.path.read_bytes() == bench.raw
    before_ns = bench.clock.now_ns()
    bench.readout.arm(SETTINGS)  # nothing is owed any more
    assert bench.clock.now_ns() - before_ns < 100 * MS


def test_a_photo_is_fetched_once_for_each_arming(armed: Bench) -> None:
    armed.camera.add("a.cr2", armed.raw)
    armed.readout.fetch(armed.root, "shot", 5.0)
    with pytest.raises(ExposureError, match="call arm first"):
        armed.readout.fetch(armed.root, "again", 5.0)
    armed.readout.arm(SETTINGS)
    armed.readout.disconnect()
    with pytest.raises(ExposureError, match="call arm first"):
        armed.readout.fetch(armed.root, "again", 5.0)


def test_a_raw_file_that_is_no_tiff_is_not_looked_into(armed: Bench) -> None:
    armed.camera.add("a.RAF", b"FUJIFILMCCD-RAW " * 4)
    raw = armed.readout.fetch(armed.root, "shot", 5.0)
    assert (raw.path.name, raw.size_bytes) == ("shot.raf", 64)


def test_a_disk_that_refuses_at_the_end_leaves_nothing(
    armed: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole_open = Path.open

    class Unflushed:
        def __init__(self, file: Any) -> None:
            self.file = file

        def __enter__(self) -> Unflushed:
            return self

        def __exit__(self, *_: object) -> None:
            self.file.close()

        def write(self, data: bytes) -> int:
            return len(data)

        def flush(self) -> None:
            raise OSError(5, "Input/output error")

    def opened(path: Path, mode: str = "r", *args: Any) -> Any:
        file = whole_open(path, mode, *args)
        return Unflushed(file) if mode == "xb" else file

    armed.camera.add("a.cr2", armed.raw)
    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(DiskError):
        armed.readout.fetch(armed.root, "shot", 5.0)
    assert not (armed.root / "shot.cr2").exists()


def test_both_have_not_been_tried_on_a_camera() -> None:
    assert GphotoShutter.maturity == GphotoReadout.maturity == "experimental"
