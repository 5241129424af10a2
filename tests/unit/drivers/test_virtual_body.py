"""The virtual body's answers, operation by operation, without a transport."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from drivers.ptp.codes import ExposureMode, FocusMode
from drivers.ptp.events import ObjectAdded, PropValue, parse_events
from drivers.virtual_camera.body import CameraBody
from drivers.virtual_camera.faults import FaultScript
from drivers.virtual_camera.films import PlainFilm
from drivers.virtual_camera.model import BULB_BODY, CameraModel
from drivers.virtual_camera.reply import CameraReply
from pdcd.bench.clock import VirtualClock

OK, GENERAL, NO_SESSION, UNSUPPORTED, BAD_HANDLE = 0x2001, 0x2002, 0x2003, 0x2005, 0x2009

BAD_PROPERTY, FULL, BUSY, BAD_VALUE, BAD_PARAMETER = 0x200A, 0x200C, 0x2019, 0x201C, 0x201D

OPEN, CLOSE, REMOTE, EVENTS, GET_EVENT, SET = 0x1002, 0x1003, 0x9114, 0x9115, 0x9116, 0x9110

START, END, KEEP_ON = 0x9125, 0x9126, 0x911D

SHOTS, DESTINATION = 0xD11B, 0xD11C


class Camera:
    """A body, and what is asked of it."""

    def __init__(self, model: CameraModel = BULB_BODY, **script: Any) -> None:
        self.clock = VirtualClock()
        self.behind: list[Any] = []
        self.body = CameraBody(
            self.clock, PlainFilm(lambda _: b"photo"), model, FaultScript(**script)
        )

    def ask(self, code: int, *parameters: int, data: bytes = b"") -> int:
        return self.body.transact(code, parameters, data).code

    def set(self, prop: int, value: int) -> int:
        return self.ask(SET, data=struct.pack("<3I", 12, prop, value))

    def heard(self) -> list[Any]:
        reply = self.body.transact(GET_EVENT)
        assert reply.code == OK and reply.data is not None
        return parse_events(reply.data)

    def begin(self) -> Camera:
        """In remote and event mode, bulb, all heard."""
        assert [self.ask(*word) for word in ((OPEN, 1), (REMOTE, 1), (EVENTS, 1))] == [OK] * 3
        self.set(0xD102, 0x0C)
        self.heard()
        return self

    def wait(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * 1e9))

    def photo(self) -> ObjectAdded:
        assert self.ask(START) == OK
        self.wait(1.0)
        assert self.ask(END) == OK
        self.wait(1.0)
        found, *self.behind = self.heard()
        assert isinstance(found, ObjectAdded)
        return found


def test_a_session_is_opened_once_and_by_a_number() -> None:
    camera = Camera()
    assert not camera.body.session_open
    assert camera.body.transact(0x1001).data == BULB_BODY.info.pack()  # without a session
    assert camera.ask(OPEN, 0) == camera.ask(OPEN) == BAD_PARAMETER
    assert camera.ask(OPEN, 7) == OK and camera.body.session_open
    assert camera.body.transact(OPEN, (9,)) == CameraReply(0x201E, (7,))
    assert camera.ask(CLOSE) == OK and not camera.body.session_open
    assert camera.ask(CLOSE) == NO_SESSION


@pytest.mark.parametrize("end", [lambda c: c.ask(CLOSE), lambda c: c.body.forget_session()])
def test_the_modes_go_with_the_session_and_an_open_shutter_stays(end: Any) -> None:
    camera = Camera().begin()
    camera.ask(START)
    camera.ask(0x9127, 0xD103)  # one record waits
    end(camera)
    assert camera.body.shutter.is_open
    camera.ask(OPEN, 1)
    assert camera.heard() == []  # no event mode, and nothing is left to tell
    camera.ask(END)
    camera.wait(1.0)
    assert camera.ask(START) == GENERAL  # no remote mode
    camera.ask(EVENTS, 1)
    told = [record.prop for record in camera.heard() if isinstance(record, PropValue)]
    assert told.count(0xD103) == 1  # the record that waited went with the session


def test_a_setting_is_refused_for_its_own_reason() -> None:
    camera = Camera().begin()
    assert camera.ask(SET, data=b"\x0c\0\0\0") == BAD_PARAMETER
    assert camera.set(0xDEAD, 1) == BAD_PROPERTY
    assert camera.set(0xD103, 0x40) == BAD_VALUE
    assert camera.set(0xD103, 0x50) == OK
    assert camera.heard() == [PropValue.of(0xD103, 0x50)]
    camera.ask(START)
    assert camera.set(0xD103, 0x48) == BUSY and camera.set(0xDEAD, 1) == BAD_PROPERTY
    assert camera.ask(0x9127, 0xDEAD) == GENERAL
    assert camera.ask(0x9127, 0xD103) == OK
    assert camera.heard() == [PropValue.of(0xD103, 0x50)]


@pytest.mark.parametrize("code", [0x100B, 0x9105])
def test_a_photo_on_the_card_stays_until_it_is_deleted(code: int) -> None:
    camera = Camera().begin()
    photo = camera.photo()
    assert camera.behind == []
    assert camera.ask(0x9117, photo.handle) == OK and camera.heard() == []
    assert camera.ask(code, photo.handle + 1) == BAD_HANDLE
    assert camera.ask(code, photo.handle) == OK
    assert camera.heard() == [PropValue.of(SHOTS, 92)]
    assert camera.ask(code, photo.handle) == BAD_HANDLE


# The release.


@pytest.mark.parametrize(
    ("script", "bulb", "timed"),
    [
        ({}, OK, (OK, (0,))),
        ({"dial": ExposureMode.PROGRAM}, GENERAL, (GENERAL, ())),
        ({"battery": 0}, GENERAL, (GENERAL, ())),
        ({"focus": FocusMode.AI_FOCUS}, GENERAL, (OK, (1,))),  # it could not focus
        ({"buffer_full": True}, FULL, (FULL, ())),
    ],
)
def test_a_body_releases_where_it_is_set_for_it(
    script: dict[str, Any], bulb: int, timed: tuple[int, tuple[int, ...]]
) -> None:
    held, pressed, released = (Camera(**script).begin() for _ in range(3))
    held.body.settings._values[0xD102] = pressed.body.settings._values[0xD102] = 0x0C
    assert held.ask(START) == bulb
    pressed.body.press()
    assert held.body.shutter.opened == pressed.body.shutter.opened == int(bulb == OK)
    released.body.settings._values[0xD102] = 0x38
    reply = released.body.transact(0x910F)
    assert (reply.code, reply.parameters) == timed
    assert released.body.shutter.opened == int(timed == (OK, (0,)))


# The cable, and faults.
