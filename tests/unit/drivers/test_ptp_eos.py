"""The camera that both drivers share: sessions, exposures that are ended, photos that nobody wants.

On the virtual camera; what a body refuses is put in between.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.ptp.codes import Operation, Property, ResponseCode
from drivers.ptp.eos import EosCamera
from drivers.ptp.events import EosRecord, ObjectAdded, PlainRecord, PropValue, pack_events
from drivers.ptp.faults import TransactionMismatch
from drivers.ptp.transport import TransactionReply
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import Config, LimitsConfig, RigConfig
from pdcd.errors import ExposureError
from tests.ptp_rig import SETTINGS, Calls, PtpRig, answer


def refuse(
    rig: PtpRig, *refused: Operation, with_code: ResponseCode = ResponseCode.GENERAL_ERROR
) -> None:
    """From here on the camera does not do that."""
    order = rig.camera.bulb._order

    def asked(code: Operation, *params: int, once: bool = False) -> TransactionReply:
        if code in refused:
            return TransactionReply(with_code, (), memoryview(b""))
        return order(code, *params, once=once)

    rig.camera.bulb._order = asked


def test_a_camera_that_refuses_to_close_gets_a_new_session(rig: PtpRig) -> None:
    """Which begins with a closed shutter, and of that exposure no more is heard."""
    rig.shutter.open()
    order = rig.camera.bulb._order
    refuse(rig, Operation.EOS_BULB_END, with_code=ResponseCode.GENERAL_ERROR)
    opened: list[None] = []
    renew = rig.camera.renew

    def renewed() -> None:
        opened.append(None)
        rig.camera.bulb._order = order
        renew()

    rig.camera.renew = renewed  # type: ignore[method-assign]
    with pytest.raises(ExposureError, match="refuses to close"):
        rig.shutter.close()
    assert len(opened) == 1
    assert rig.camera.bulb.since_ns is None and not rig.body.shutter.is_open


def test_who_ends_an_exposure_is_told_whether_there_was_one(rig: PtpRig) -> None:
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    assert [rig.camera.end_exposure(), rig.camera.end_exposure()] == [True, False]


def test_a_photo_is_owed_until_it_was_thrown_away(rig: PtpRig, tmp_path: Path) -> None:
    """Whoever closes what is closed asks nothing of a camera that might not answer."""
    rig.expose()
    rig.wait(2.0)
    rig.camera.poll()
    calls = Calls(rig, {})
    rig.camera.end_exposure()
    assert rig.camera.bulb.owed and len(rig.camera.files) == 1 and calls.done == []
    rig.readout.arm(SETTINGS)
    assert not rig.camera.bulb.owed and not rig.camera.files


def test_the_last_to_go_hands_the_camera_back_to_its_own_buttons(rig: PtpRig) -> None:
    told: list[tuple[int, tuple[int, ...]]] = []
    transact = rig.body.transact

    def heard(code: int, parameters: tuple[int, ...] = (), data: bytes = b"") -> object:
        told.append((code, parameters[:1]))
        return transact(code, parameters, data)

    rig.body.transact = heard  # type: ignore[method-assign, assignment]
    rig.readout.disconnect()
    assert (0x9114, (0,)) not in told and rig.body.session_open
    rig.shutter.disconnect()
    codes = [code for code, _ in told]
    assert (0x9115, (0,)) in told and (0x9114, (0,)) in told
    assert codes.index(0x1003) > codes.index(0x9114)  # modes first, then the session
    assert not rig.body.session_open
    assert rig.body.settings[Property.CAPTURE_DESTINATION] != 4  # the card again


def test_a_pause_is_a_sign_of_life(rig: PtpRig) -> None:
    signs: list[int] = []
    rig.job.on_look = lambda: signs.append(rig.clock.now_ns())
    before_ns = rig.clock.now_ns()
    rig.camera.pause(0.25)
    assert [ns - before_ns for ns in signs] == [0, 200_000_000, 250_000_000]


def test_a_value_that_was_not_taken_is_not_believed(rig: PtpRig) -> None:
    iso = rig.camera.values[Property.ISO]
    other = next(value for value in rig.camera.choices[Property.ISO] if value != iso)
    rig.camera.set_value(Property.ISO, other, "this ISO")
    assert rig.body.settings[Property.ISO] == other
    calls = Calls(rig, {})
    rig.camera.set_value(Property.ISO, other, "this ISO")
    assert calls.done == []  # it is set already
    with pytest.raises(ExposureError, match=r"does not take this ISO \(set it on the camera"):
        rig.camera.set_value(Property.ISO, 0xEE, "this ISO")
    assert rig.camera.values.get(Property.ISO) != 0xEE
    assert rig.body.settings[Property.ISO] == other


BUSY = ResponseCode.DEVICE_BUSY

PING = Operation.EOS_KEEP_DEVICE_ON


def test_a_busy_camera_is_asked_again_ever_more_slowly_for_five_seconds(rig: PtpRig) -> None:
    calls = Calls(rig, {PING: [answer(BUSY)] * 100})
    before_ns = rig.clock.now_ns()
    assert rig.camera.order(PING).code == BUSY
    at_ms = [(at - before_ns) // 1_000_000 for at in calls.times(PING)]
    assert at_ms == [0, 50, 150, 350, 750, 1550, 2350, 3150, 3950, 4750, 5550]
    assert len(calls.times(Operation.EOS_GET_EVENT)) >= 10  # its events are heard meanwhile


def test_events_are_heard_until_there_are_none_and_64_times_at_most(rig: PtpRig) -> None:
    record = pack_events([PropValue.of(0xD103, 0x50)])
    calls = Calls(rig, {Operation.EOS_GET_EVENT: [answer(0x2001, record)] * 1000})
    rig.camera.poll()
    assert len(calls.done) == 64 and rig.camera.values[0xD103] == 0x50
    # What cannot be read does not hide what is behind it, and a busy camera is asked another time.
    calls.done.clear()
    damaged = answer(0x2001, b"\x07\0\0\0")
    calls.answers[Operation.EOS_GET_EVENT] = [damaged, answer(BUSY, record)]
    rig.camera.poll()
    assert len(calls.done) == 2


def test_what_is_told_is_kept_by_its_kind(rig: PtpRig) -> None:
    camera = rig.camera
    camera.custom = {1: 2}
    told: list[EosRecord] = [
        PropValue.of(0xD111, 1),
        PropValue(0xD112, b"\1\0"),  # not a number of 32 bits: not kept
        PropValue(0xD1A0, b"\xff"),  # packed otherwise: what is known stays
        PlainRecord(0xC18D, bytes(4)),
    ]
    calls = Calls(rig, {Operation.EOS_GET_EVENT: [answer(0x2001, pack_events(told))]})
    camera.poll()
    assert camera.values[0xD111] == 1 and 0xD112 not in camera.values
    assert camera.custom == {1: 2}
    assert len(calls.times(PING)) == 1  # it would switch itself off


def test_a_photo_on_the_card_is_not_announced_to_us_twice(rig: PtpRig) -> None:
    card = ObjectAdded(7, 0xB103, 5, "IMG_0001.CR2", True)
    assert rig.camera.discard(card)
    other = ObjectAdded(8, 0xB103, 5, "IMG_0002.CR2", True)
    told = answer(0x2001, pack_events([card, other]))
    Calls(rig, {Operation.EOS_GET_EVENT: [told]})
    rig.camera.poll()
    assert [photo.handle for photo in rig.camera.files] == [8]


def test_a_camera_that_tells_no_settings_is_out_of_step_after_a_second(rig: PtpRig) -> None:
    Calls(rig, {Operation.EOS_GET_EVENT: [answer(0x2001, pack_events([]))] * 1000})
    before_ns = rig.clock.now_ns()
    with pytest.raises(TransactionMismatch, match="does not tell its settings"):
        rig.camera._set_modes()
    assert rig.clock.now_ns() - before_ns == 20 * 50 * 1_000_000
    assert not rig.camera.values and not rig.camera.choices


def test_a_body_that_refuses_a_mode_is_named_with_its_answer(rig: PtpRig) -> None:
    Calls(rig, {Operation.EOS_SET_EVENT_MODE: [answer(0x2005)]})
    with pytest.raises(ExposureError, match=r"EOS_SET_EVENT_MODE is refused: 0x2005 OPERATION_NOT"):
        rig.camera._set_modes()


def test_an_exposure_that_was_told_of_is_ended_by_its_own_time(rig: PtpRig) -> None:
    rig.shutter.expect_exposure(2.0, 34.0)
    rig.shutter.open()
    open_ns = rig.camera.bulb.since_ns
    assert open_ns is not None
    for t_ns, is_open in ((open_ns + 34_000_000_000, True), (open_ns + 34_000_000_001, False)):
        rig.clock.sleep_until_ns(t_ns)
        rig.camera.tick()
        assert rig.body.shutter.is_open == is_open
    with pytest.raises(ExposureError, match="longer than the 34 s that it can take"):
        rig.shutter.close()
    rig.readout.arm(CameraSettings(100, None))
    rig.shutter.open()  # of this one nothing is known
    rig.wait(60.0)
    rig.camera.tick()
    assert rig.body.shutter.is_open
    rig.shutter.close()
    rig.shutter.expect_exposure(2.0, 1e9)  # beyond the limit of all
    rig.readout.arm(CameraSettings(100, None))
    rig.shutter.open()
    rig.wait(611.0)
    rig.camera.tick()
    assert not rig.body.shutter.is_open


def test_exposures_without_a_longest_one_are_not_overdue_after_a_day() -> None:
    longest = LimitsConfig(max_exposure_s=float("inf"))
    context = DriverContext(Config(rig=RigConfig(clock="real"), limits=longest), VirtualClock())
    camera = EosCamera.of(context)
    camera.bulb.since_ns = context.clock.now_ns()
    context.clock.sleep_until_ns(10**14)
    assert not camera.bulb.overdue(camera._longest_ns)
