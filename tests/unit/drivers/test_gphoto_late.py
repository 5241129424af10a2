"""Photos that come late, cameras that are busy, and sizes that no sensor has, over gphoto2."""

from __future__ import annotations

import pytest

pytest.importorskip("gphoto2", reason="gphoto2 IS MISSING: see .venv/gphoto2.log")

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gphoto2 as gp

from drivers.gphoto.camera import _close_forgotten
from drivers.gphoto.guardian import close_bulb
from pdcd.bench.devices import CameraSettings
from pdcd.capture.safety import make_safe
from pdcd.errors import Cancelled, ConfigError, DeviceLost, ExposureError
from tests.fake_gphoto import Setting, failure
from tests.gphoto_bench import MS, Bench, Camera

SETTINGS = CameraSettings(iso=100, f_number=None)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Bench:
    return Bench(monkeypatch, tmp_path)


@pytest.fixture
def armed(bench: Bench) -> Bench:
    bench.readout.connect()
    bench.readout.arm(SETTINGS)
    return bench


def expose(bench: Bench, seconds: float = 1.0) -> None:
    bench.readout.arm(SETTINGS)
    bench.shutter.open()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + round(seconds * 1000) * MS)
    bench.shutter.close()


@pytest.mark.parametrize("after_s", [0.5, 14.0, 60.0, 600.0])
@pytest.mark.parametrize("how", ["time-out", "cancel", "lost"])
def test_a_photo_that_comes_when_it_was_given_up_is_never_taken_for_another(
    bench: Bench, how: str, after_s: float
) -> None:
    """Given up after a minute, which is longer than the exposure and all that it may take."""
    bench.readout.connect()
    bench.shutter.connect()
    expose(bench)
    if how == "cancel":
        alive = bench.clock.now_ns() + 30_000 * MS
        bench.on_look = lambda: setattr(bench, "cancelled", bench.clock.now_ns() > alive)
    elif how == "lost":
        bench.camera.later(1.0, "late.jpg", b"x")
        bench.camera.sizes["late.jpg"] = 1 << 40
    with pytest.raises(Cancelled if how == "cancel" else ExposureError):
        bench.readout.fetch(bench.root, "one", 60.0)
    bench.on_look, bench.cancelled = (lambda: None), False
    bench.camera.later(after_s, "late.cr2", b"II*\0")
    told = 0
    for _ in range(100):
        try:
            bench.readout.arm(SETTINGS)
            break
        except ExposureError as err:
            assert "has not come" in str(err)
            told += 1
            bench.clock.sleep_until_ns(bench.clock.now_ns() + 10_000 * MS)
    assert bench.camera.fetched[-1] == "late.cr2" and (told > 0) == (after_s > 20.0)
    bench.shutter.open()
    bench.shutter.close()
    bench.camera.later(1.0, "next.cr2", bench.raw)
    assert bench.readout.fetch(bench.root, "two", 60.0).path.read_bytes() == bench.raw


def test_pictures_without_end_do_not_keep_a_photo_from_being_given_up(bench: Bench) -> None:
    """Each is thrown away, and takes a second."""
    bench.readout.connect()
    get = bench.camera.file_get

    def slow(*given: Any) -> None:
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 1000 * MS)
        get(*given)

    bench.camera.file_get = slow  # type: ignore[method-assign, assignment]
    for number in range(1000):
        bench.camera.add(f"{number}.jpg", b"x")
    begun_ns = bench.clock.now_ns()
    with pytest.raises(DeviceLost, match="get ready for a photo in time"):
        bench.readout.arm(SETTINGS)
    assert bench.clock.now_ns() - begun_ns < 122_000 * MS


def test_a_camera_that_is_silent_is_asked_to_close_once_in_its_time(bench: Bench) -> None:
    """Each call takes libgphoto2's whole time-out, in which nothing can be heard."""
    bench.shutter.connect()
    bench.shutter.open()
    asked = 0

    def silent(name: str) -> Setting:
        nonlocal asked
        asked += 1
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 20_000 * MS)
        raise failure(gp.GP_ERROR_TIMEOUT)

    bench.camera.get_single_config = silent  # type: ignore[method-assign]
    patience = bench.session.patience
    assert not make_safe(SimpleNamespace(black=lambda: None), bench.shutter, patience)
    assert asked == 1 and bench.session.shutter_open


def test_a_shutter_that_is_forgotten_after_a_cancel_is_closed(bench: Bench) -> None:
    bench.shutter.connect()
    bench.shutter.open()
    bench.cancelled = True
    _close_forgotten(bench.session)
    assert bench.camera.settings["bulb"].value == 0


def test_a_camera_that_was_switched_off_owes_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.readout.connect()
    bench.shutter.connect()
    expose(bench)
    with pytest.raises(ExposureError):
        bench.readout.fetch(bench.root, "one", 1.0)
    bench.camera.broken = failure(gp.GP_ERROR_IO)
    with pytest.raises(DeviceLost):
        bench.readout.arm(SETTINGS)
    again = Camera(bench.clock)
    again.place = "usb:001,005"
    monkeypatch.setattr(gp, "Camera", lambda: again)
    before_ns = bench.clock.now_ns()
    bench.readout.arm(SETTINGS)
    assert bench.clock.now_ns() - before_ns < 200 * MS
    assert again.settings["capturetarget"].value == "Internal RAM"
    again.add("a.cr2", bench.raw)
    assert bench.readout.fetch(bench.root, "two", 5.0).path.read_bytes() == bench.raw


def test_the_photo_of_a_cable_release_is_waited_for_and_then_forgotten(bench: Bench) -> None:
    """Nobody knows whether the cable was pressed."""
    bench.readout.connect()
    bench.readout.arm(SETTINGS)
    before_ns = bench.clock.now_ns()
    bench.readout.arm(SETTINGS)
    assert bench.clock.now_ns() - before_ns == pytest.approx(15e9, abs=3e8)


def test_a_photo_larger_than_any_of_its_sensor_is_not_fetched(armed: Bench) -> None:
    armed.camera.add("a.cr2", armed.raw)
    armed.camera.sizes["a.cr2"] = 4 << 30
    with pytest.raises(ExposureError, match=r"4294967296 bytes.* at most"):
        armed.readout.fetch(armed.root, "shot", 5.0)
    assert armed.camera.fetched == []


def test_a_cancel_is_heard_within_a_second(armed: Bench) -> None:
    before_ns = armed.clock.now_ns()
    armed.on_look = lambda: setattr(armed, "cancelled", armed.clock.now_ns() > before_ns)
    with pytest.raises(Cancelled):
        armed.readout.fetch(armed.root, "shot", 60.0)
    assert armed.clock.now_ns() - before_ns <= 1000 * MS


@pytest.mark.parametrize("value", [1, 0])
@pytest.mark.parametrize("times", [1, 5, 10**6])
def test_a_camera_that_is_busy_is_asked_again(bench: Bench, value: int, times: int) -> None:
    """It says that it did nothing, so that a start is not made twice."""
    bench.shutter.connect()
    if not value:
        bench.shutter.open()
    bench.camera.written.clear()
    bench.camera.busy = times
    move = bench.shutter.open if value else bench.shutter.close
    before_ns = bench.clock.now_ns()
    if times > 5:
        with pytest.raises(DeviceLost, match="until it has written"):
            move()
        assert 5000 * MS <= bench.clock.now_ns() - before_ns < 6000 * MS
        bench.camera.busy = 0
        bench.shutter.close()
    else:
        move()
        assert bench.camera.written == [("bulb", value)]


def test_a_target_that_is_not_there_names_the_one_that_is(bench: Bench) -> None:
    bench.camera.settings["capturetarget"] = Setting("Memory card", ("Memory card",))
    with pytest.raises(ConfigError, match=r'Memory card \(set destination = "card"'):
        bench.readout.connect()


def test_a_shutter_is_guarded_before_it_opens_until_it_is_surely_closed(bench: Bench) -> None:
    told: list[str] = bench.shutter._guard.words  # type: ignore[attr-defined]
    heard: list[list[str]] = []
    bench.camera.on_bulb = lambda _: heard.append(list(told))
    bench.shutter.connect()
    told.clear()
    bench.shutter.open()
    bench.shutter.close()
    assert heard[-2:] == [["arm"], ["arm"]] and told == ["arm", "disarm"]
    bench.shutter.open()
    bench.camera.refuses_bulb = failure(gp.GP_ERROR)
    with pytest.raises(DeviceLost):
        bench.shutter.disconnect()
    assert told[2:] == ["arm", "stop False"]  # which closes it once the camera is free


@pytest.mark.parametrize("refuses", [None, gp.GP_ERROR, gp.GP_ERROR_IO])
def test_its_guardian_ends_the_exposure_of_a_camera_that_is_free(
    bench: Bench, refuses: int | None
) -> None:
    """A camera that refuses holds none; one that is lost is tried again."""
    if refuses is not None:
        bench.camera.refuses_bulb = failure(refuses)
    if refuses == gp.GP_ERROR_IO:
        with pytest.raises(DeviceLost):
            close_bulb(bench.session.options)
    else:
        close_bulb(bench.session.options)
    assert bench.camera.written == ([("bulb", 0)] if refuses is None else [])
    assert bench.camera.opened == 0
