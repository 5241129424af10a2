"""A camera that means harm: answers without end, sizes that no sensor has, and no answer at all.

Whatever it does, a cancel is heard within a second, a photo is waited for as long as it may take
and a second more, and no more is read than a photo has.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.ptp.codes import Operation, ResponseCode
from drivers.ptp.eos import EosCamera
from drivers.ptp.events import ObjectAdded, PropValue, pack_events
from drivers.virtual_camera import FaultScript
from drivers.virtual_camera.reply import CameraReply
from pdcd.capture.safety import make_safe, release_device
from pdcd.errors import Cancelled, DeviceLost, ExposureError, PdcdError
from pdcd.sensor.profile import load_profile
from tests.hostile.camera import BUSY, MOODS, MUTE, HostileBody, HostileUsb
from tests.ptp_rig import SETTINGS, PtpRig

GET_EVENT, READ = Operation.EOS_GET_EVENT, Operation.GET_PARTIAL_OBJECT
SECOND_NS = 1_000_000_000


def answer_always(rig: PtpRig, reply: CameraReply) -> None:
    rig.body.transact = lambda *_: reply  # type: ignore[method-assign]


def answer(rig: PtpRig, code: Operation, reply: Callable[..., bytes], seconds: float) -> list[int]:
    """Have the body answer an operation by these bytes, after so long; when it was asked."""
    real = rig.body.transact
    asked: list[int] = []

    def transact(done: int, parameters: tuple[int, ...] = (), data: bytes = b"") -> CameraReply:
        if done != code:
            return real(done, parameters, data)
        asked.append(rig.clock.now_ns())
        rig.wait(seconds)
        return CameraReply(data=reply(*parameters))

    rig.body.transact = transact  # type: ignore[method-assign, assignment]
    return asked


def give_a_byte(_: int, at: int, want: int) -> bytes:
    """One of a photo, behind what RAW files begin with, however many are wanted."""
    return b"x" if at else b"II*\0"


def tell_photos() -> Callable[..., bytes]:
    """Ever more photos, a hundred in each list."""
    number = iter(range(1, 1 << 30))
    return lambda *_: pack_events(
        ObjectAdded(next(number), 0x3801, 100, "IMG_0001.JPG", on_card=True) for _ in range(100)
    )


def tell_settings() -> Callable[..., bytes]:
    """Ever more settings, a thousand in each list."""
    number = iter(range(0x10000, 1 << 31))
    return lambda *_: pack_events(PropValue.of(next(number), 1) for _ in range(1000))


@pytest.mark.parametrize(
    "reply",
    [lambda *_: bytes(3 << 20), tell_photos(), tell_settings()],
    ids=["a list of 3 MiB", "photos", "settings"],
)
def test_there_is_an_end_to_what_a_camera_may_tell(reply: Callable[..., bytes]) -> None:
    rig = PtpRig()
    rig.connect()
    real = rig.body.transact
    answer(rig, GET_EVENT, reply, 0.0)
    begun_ns = rig.clock.now_ns()
    with pytest.raises(DeviceLost):
        rig.camera.poll()
    assert rig.clock.now_ns() - begun_ns < 60 * SECOND_NS
    assert len(rig.camera.files) <= 256 and len(rig.camera.values) <= 4096
    rig.body.transact = real  # type: ignore[method-assign]
    rig.readout.arm(SETTINGS)  # an honest camera tells its settings once a session


def test_a_list_of_more_events_than_there_can_be_is_passed_over() -> None:
    rig = PtpRig()
    rig.connect()
    asked = answer(rig, GET_EVENT, lambda *_: struct.pack("<II", 8, 0xC1FF) * 100_000, 0.0)
    known = dict(rig.camera.values)
    rig.camera.poll()
    assert len(asked) == 3 and rig.camera.values == known


def test_a_photo_larger_than_any_of_its_sensor_is_not_even_begun(tmp_path: Path) -> None:
    """4 GiB of a sensor of 12 megapixels."""
    rig = PtpRig()
    rig.connect()
    rig.camera.most_photo_bytes = load_profile("450d").largest_photo_bytes
    assert 30e6 < rig.camera.most_photo_bytes < 200e6
    rig.expose()
    photo = ObjectAdded(0x91, 0xB103, 0xFFFFFFFF, "IMG_0001.CR2", on_card=False)
    answer(rig, GET_EVENT, lambda *_: pack_events([photo]), 0.01)
    read = answer(rig, READ, lambda _, at, want: bytes(want), 0.0)
    with pytest.raises(ExposureError, match=r"4294967295 bytes.* at most"):
        rig.readout.fetch(tmp_path, "photo", 60.0)
    assert not read and not [*tmp_path.iterdir()]


def test_a_photo_that_comes_a_byte_at_a_time_is_given_up_in_time(tmp_path: Path) -> None:
    rig = PtpRig()
    rig.connect()
    rig.expose()
    answer(rig, READ, give_a_byte, 0.05)
    begun_ns = rig.clock.now_ns()
    with pytest.raises(ExposureError, match="did not come whole within 20 s"):
        rig.readout.fetch(tmp_path, "photo", 20.0)
    assert 20 * SECOND_NS < rig.clock.now_ns() - begun_ns < 21.1 * SECOND_NS
    assert not [*tmp_path.iterdir()]


WAITS = ("no photo", "a byte at a time", "no answer", "no photo before", "busy", "gone")


def wait(what: str, rig: PtpRig, folder: Path) -> None:
    """Wait for the camera in one of the ways in which it can be waited for."""
    if what == "a byte at a time":
        answer(rig, READ, give_a_byte, 0.05)
    elif what == "no answer":
        answer_always(rig, MUTE)
    elif what == "busy":
        answer_always(rig, BUSY)
    elif what == "gone":
        rig.body.unplug()
    if what in ("no photo", "a byte at a time", "no answer"):
        rig.readout.fetch(folder, "photo", 60.0)
    else:
        rig.readout.arm(SETTINGS)


@pytest.mark.parametrize("after_s", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("what", WAITS)
def test_a_cancel_is_heard_within_a_second(what: str, after_s: float, tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(file="none") if what.startswith("no photo") else None)
    rig.connect()
    rig.expose()
    begun_ns = rig.clock.now_ns()

    def look() -> None:
        rig.job.cancelled = rig.clock.now_ns() >= begun_ns + after_s * SECOND_NS

    rig.job.on_look = look
    with pytest.raises(Cancelled):
        wait(what, rig, tmp_path)
    # Making safe asks nothing of a camera whose shutter is closed.
    rig.shutter.close()
    assert rig.clock.now_ns() - begun_ns <= (after_s + 1.0) * SECOND_NS
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("late_s", [0.4, 1.2])
@pytest.mark.parametrize("after_s", [0.5, 3.0, 4.0])
def test_a_cancel_is_heard_within_a_second_while_a_session_begins(
    late_s: float, after_s: float
) -> None:
    """A shutter that another program left open is still closed, if the camera has half a second."""
    rig = PtpRig(body=HostileBody, usb=HostileUsb)
    rig.connect()
    rig.camera.session.close()
    assert isinstance(rig.body, HostileBody) and isinstance(rig.usb, HostileUsb)
    rig.body.mood, rig.usb.late_s = "late", late_s
    begun_ns = rig.clock.now_ns()

    def look() -> None:
        rig.job.cancelled = rig.clock.now_ns() >= begun_ns + after_s * SECOND_NS

    rig.job.on_look = look
    with pytest.raises(Cancelled):
        rig.camera.open("readout")
    assert rig.clock.now_ns() - begun_ns <= (after_s + 1.0) * SECOND_NS


def test_what_was_cancelled_does_not_spoil_the_next_exposure(tmp_path: Path) -> None:
    rig = PtpRig()
    rig.connect()
    rig.expose()
    asked = answer(rig, READ, lambda *_: b"", 0.0)
    rig.job.on_look = lambda: setattr(rig.job, "cancelled", bool(asked))
    real = type(rig.body).transact.__get__(rig.body)
    with pytest.raises((Cancelled, ExposureError)):
        rig.readout.fetch(tmp_path, "one", 60.0)
    rig.job.on_look, rig.job.cancelled = (lambda: None), False
    rig.body.transact = real  # type: ignore[method-assign]
    raw = rig.photo(tmp_path, "two")
    assert rig.is_photo_of(raw, rig.body.shutter.exposures[-1])
    assert rig.body.store.in_ram == 0


def test_closing_hears_no_cancel() -> None:
    rig = PtpRig()
    rig.connect()
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    rig.job.cancelled = True
    with rig.context.patience.deaf():
        rig.shutter.close()
    assert not rig.body.shutter.is_open


class Dark:
    """Panels that are black."""

    def black(self) -> None:
        pass


def open_hostile(release: str = "auto") -> tuple[PtpRig, HostileBody, HostileUsb]:
    """A rig whose shutter is open."""
    rig = PtpRig(body=HostileBody, usb=HostileUsb, camera={"release": release})
    rig.connect()
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    assert isinstance(rig.body, HostileBody) and isinstance(rig.usb, HostileUsb)
    return rig, rig.body, rig.usb


@pytest.mark.parametrize("late_s", [3.0, 7.5, 30.0])
@pytest.mark.parametrize("mood", sorted(MOODS))
def test_all_tries_to_close_share_one_deadline(mood: str, late_s: float) -> None:
    rig, body, usb = open_hostile()
    body.mood, usb.late_s = mood, late_s
    if mood in ("busy", "refuses"):  # and does not even close
        refused = BUSY if mood == "busy" else CameraReply(ResponseCode.GENERAL_ERROR)
        answer_always(rig, refused)
    begun_ns = rig.clock.now_ns()
    with suppress(PdcdError):
        rig.shutter.close()
    safe = make_safe(Dark(), rig.shutter, rig.context.patience)  # type: ignore[arg-type]
    assert rig.clock.now_ns() - begun_ns < 14.0 * SECOND_NS
    assert safe == (rig.camera.bulb.since_ns is None)
    assert not (safe and body.shutter.is_open)
    vars(body).pop("transact", None)
    body.mood = "honest"
    if not safe:  # nobody else tries
        with suppress(ExposureError):
            rig.camera.tick()
        assert rig.camera.bulb.since_ns is None
        with pytest.raises(ExposureError, match="the camera closed late"):
            rig.shutter.close()
    assert not body.shutter.is_open


@pytest.mark.parametrize("mood", sorted(MOODS))
def test_a_rig_is_let_go_in_time(mood: str) -> None:
    rig, body, usb = open_hostile()
    body.mood, usb.late_s = mood, 7.5
    begun_ns = rig.clock.now_ns()
    for device in (rig.readout, rig.shutter):
        release_device("device", device.disconnect, rig.context.patience)
    assert rig.clock.now_ns() - begun_ns < 20.0 * SECOND_NS
    assert usb._claimed_by is None and rig.camera._alive is None


@pytest.mark.whole
@pytest.mark.parametrize("mood", ["drips", "long lists", "4 GiB", "a byte at a time"])
def test_a_guardian_closes_first_and_hears_settings_later(mood: str) -> None:
    """The program that opened it is gone. A camera that does not even greet cannot be closed."""
    rig, body, usb = open_hostile()
    usb._claimed_by = None
    body.mood, usb.late_s = mood, 7.5
    camera = EosCamera(rig.camera.options, rig.clock, usb, 60.0)
    begun_ns = rig.clock.now_ns()
    with suppress(PdcdError):
        camera.open("guardian")
    camera.let_go("guardian")
    assert not body.shutter.is_open
    assert rig.clock.now_ns() - begun_ns < 60.0 * SECOND_NS


def test_the_thread_that_keeps_the_camera_awake_gives_way() -> None:
    """It waits for a camera that does not answer, while somebody wants to close."""
    rig = PtpRig()
    rig.connect()
    answer_always(rig, MUTE)
    begun_ns = rig.clock.now_ns()
    rig.job.on_look = rig.camera.session.wanted.set
    with pytest.raises(Cancelled):
        rig.camera.tick()
    assert rig.clock.now_ns() - begun_ns <= SECOND_NS
