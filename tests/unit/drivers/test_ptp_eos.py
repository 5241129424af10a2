"""The camera that both drivers share: sessions, exposures that are ended, photos that nobody wants.

On the virtual camera; what a body refuses is put in between.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.ptp.codes import Operation, Property, ResponseCode
from drivers.ptp.transport import TransactionReply
from pdcd.errors import ExposureError
from tests.ptp_rig import SETTINGS, PtpRig


@pytest.fixture
def rig() -> Iterator[PtpRig]:
    rig = PtpRig()
    rig.connect()
    yield rig
    rig.disconnect_quietly()


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


def test_a_new_session_closes_the_shutter_and_the_exposure_is_not_used(rig: PtpRig) -> None:
    rig.shutter.open()
    rig.camera.renew()
    assert not rig.body.shutter.is_open and rig.body.session_open
    with pytest.raises(ExposureError, match="connection was lost while the shutter was open"):
        rig.shutter.close()


def test_a_session_that_ended_is_begun_again_by_an_exposure(rig: PtpRig) -> None:
    rig.camera.session.close()
    rig.shutter.open()
    assert rig.body.shutter.is_open
    rig.wait(1.0)
    rig.shutter.close()
    assert not rig.body.shutter.is_open


def test_a_session_that_ended_in_an_exposure_is_begun_again_to_end_it(rig: PtpRig) -> None:
    rig.shutter.open()
    rig.camera.session.close()
    with pytest.raises(ExposureError, match="spoiled"):
        rig.shutter.close()
    assert rig.body.session_open and not rig.body.shutter.is_open


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
    """One that the camera has not told of may still come."""
    rig.expose()
    assert rig.camera.bulb.owed
    rig.camera.files.clear()
    rig.camera.end_exposure()
    assert rig.camera.bulb.owed  # nothing was there to be thrown away
    rig.wait(2.0)
    rig.camera.poll()
    assert len(rig.camera.files) == 1
    rig.camera.end_exposure()
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
    rig.camera.tell_alive = lambda: signs.append(rig.clock.now_ns())
    before_ns = rig.clock.now_ns()
    rig.camera.pause(0.25)
    assert signs == [before_ns] and rig.clock.now_ns() == before_ns + 250_000_000


def test_events_that_cannot_be_read_do_not_hide_those_behind_them(
    rig: PtpRig, caplog: pytest.LogCaptureFixture
) -> None:
    rig.expose()
    rig.wait(2.0)
    rig.camera.files.clear()
    call, damaged = rig.camera.session.call, [b"\x07\0\0\0"]

    def first_damaged(code: Operation, *params: int, **more: object) -> TransactionReply:
        if code == Operation.EOS_GET_EVENT and damaged:
            return TransactionReply(ResponseCode.OK, (), memoryview(damaged.pop()))
        return call(code, *params, **more)  # type: ignore[arg-type]

    rig.camera.session.call = first_damaged  # type: ignore[method-assign]
    rig.camera.poll()
    assert "events lost" in caplog.text and len(rig.camera.files) == 1


def test_a_value_that_was_not_taken_is_not_believed(rig: PtpRig) -> None:
    iso = rig.camera.values[Property.ISO]
    other = next(value for value in rig.camera.choices[Property.ISO] if value != iso)
    rig.camera.set_value(Property.ISO, other, "this ISO")
    assert rig.body.settings[Property.ISO] == other
    with pytest.raises(ExposureError, match=r"does not take this ISO \(set it on the camera"):
        rig.camera.set_value(Property.ISO, 0xEE, "this ISO")
    assert rig.camera.values.get(Property.ISO) != 0xEE
    assert rig.body.settings[Property.ISO] == other
