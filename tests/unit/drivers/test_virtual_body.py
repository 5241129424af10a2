"""The virtual body's answers, operation by operation, without a transport."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from drivers.ptp.codes import ExposureMode, FocusMode
from drivers.ptp.events import ObjectAdded, PropValue, parse_events
from drivers.virtual_camera.body import DATA_OUT, CameraBody
from drivers.virtual_camera.faults import FaultScript, ScriptedFault, WireKind
from drivers.virtual_camera.films import PlainFilm
from drivers.virtual_camera.model import BULB_BODY, CameraModel
from drivers.virtual_camera.properties import Properties
from drivers.virtual_camera.reply import CameraReply
from drivers.virtual_camera.shutter import DCIM, FOLDER_HANDLE, ROOT_HANDLE, FileStore
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


def test_room_for_shots_is_told_when_it_changes_or_is_asked_for() -> None:
    camera = Camera().begin()
    camera.set(DESTINATION, 4)
    assert camera.heard() == [PropValue.of(DESTINATION, 4), PropValue.of(SHOTS, 0)]
    for parameters, shots in (((0x1000, 0x1000, 1), 5), ((1,), 5), ((0,), 0), ((), 0)):
        assert camera.ask(0x911A, *parameters) == OK
        assert camera.heard() == [PropValue.of(SHOTS, shots)]
    camera.ask(0x911A, 1)
    camera.set(DESTINATION, 4)
    assert camera.heard() == [PropValue.of(SHOTS, 5), PropValue.of(DESTINATION, 4)]


def test_a_photo_in_memory_takes_room_until_its_transfer_is_complete() -> None:
    camera = Camera().begin()
    camera.set(DESTINATION, 4)
    camera.ask(0x911A, 1)
    camera.heard()
    for code in (0x9117, 0x9118):
        photo = camera.photo()
        assert camera.behind == [PropValue.of(SHOTS, 4)]
        assert camera.ask(code, photo.handle + 1) == BAD_HANDLE
        assert camera.ask(code, photo.handle) == OK
        assert camera.heard() == [PropValue.of(SHOTS, 5)]
        assert camera.ask(code, photo.handle) == BAD_HANDLE


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


def test_the_camera_is_locked_unlocked_and_kept_on() -> None:
    camera = Camera().begin()
    assert not camera.body.ui_locked and camera.body.kept_on == 0
    assert camera.ask(0x911B) == OK and camera.body.ui_locked
    assert camera.ask(0x911C) == OK and not camera.body.ui_locked
    assert camera.ask(KEEP_ON) == camera.ask(KEEP_ON) == OK and camera.body.kept_on == 2
    assert camera.body.status() == OK


# The release.


def test_bulb_is_held_and_ended() -> None:
    camera = Camera().begin()
    assert camera.ask(END) == GENERAL
    assert camera.ask(0x910F) == GENERAL  # a timed release does not do for bulb
    assert camera.ask(START) == OK and camera.body.shutter.is_open
    assert camera.ask(START) == BUSY and camera.body.shutter.opened == 1
    assert camera.ask(END) == OK and not camera.body.shutter.is_open
    assert camera.ask(START) == BUSY  # its file is on its way
    camera.wait(1.0)
    assert camera.ask(START) == BUSY  # and must be heard of
    camera.heard()
    assert camera.ask(START) == OK


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


@pytest.mark.parametrize(
    ("kind", "code", "done", "told"),
    [
        ("busy", BUSY, 0, None),
        ("error", GENERAL, 0, None),
        ("deaf", OK, 0, "deaf"),
        ("unplug", OK, 0, "unplug"),
        ("lost-session", NO_SESSION, 0, "lost-session"),
        ("mute", OK, 1, "mute"),
        ("stall", OK, 1, "stall"),
        ("wrong-transaction", OK, 1, "wrong-transaction"),
    ],
)
def test_a_fault_is_done_or_told_to_the_transport(
    kind: WireKind, code: int, done: int, told: WireKind | None
) -> None:
    camera = Camera(wire=(ScriptedFault(kind, KEEP_ON),)).begin()
    reply = camera.body.transact(KEEP_ON)
    assert (reply.code, reply.fault, camera.body.kept_on) == (code, told, done)
    assert camera.body.plugged == (kind != "unplug")
    assert camera.body.session_open == (kind != "lost-session")


def test_what_a_sound_body_tells_at_first() -> None:
    told = Properties(BULB_BODY, FaultScript()).everything()
    values = {r.prop: r.value for r in told if isinstance(r, PropValue) and len(r.data) == 4}
    assert values == {
        0xD101: 0x30,  # f/5.6
        0xD102: 0x68,  # 1/60 s
        0xD103: 0x48,  # ISO 100
        0xD105: 3,  # the dial on M
        0xD106: 0,
        0xD108: 3,  # manual focus
        0xD111: 2,  # a full battery
        0xD114: 60,
        0xD11B: 92,  # what its card has room for
        0xD11C: 2,  # the card
        0xD11E: 0x20001,
        0xD1B0: 0,  # no live view
    }
    packed = {r.prop: r.data for r in told if isinstance(r, PropValue) and len(r.data) != 4}
    assert packed[0xD120] == struct.pack("<5I", 1, 16, 6, 0, 4)
    custom = struct.unpack(f"<{len(packed[0xD1A0]) // 4}I", packed[0xD1A0])
    assert custom[0] == len(packed[0xD1A0]) and custom[1] == 2  # bytes in all, and groups
    assert custom[2:11] == (1, 32, 2, 0x101, 1, 0, 0x10F, 1, 0)
    assert custom[11:] == (2, 32, 2, 0x201, 1, 0, 0x202, 1, 0)


def test_folders_are_those_of_a_canon_card() -> None:
    store = FileStore()
    assert (ROOT_HANDLE, DCIM, FOLDER_HANDLE) == (0, 0x41000000, 0x41900000)
    found = [store.info(DCIM), store.info(FOLDER_HANDLE)]
    assert [(i.name, i.parent, i.format, i.storage) for i in found if i] == [
        ("DCIM", ROOT_HANDLE, 0x3001, 0x20001), ("100CANON", DCIM, 0x3001, 0x20001),
    ]  # fmt: skip
    assert store.children(0) == store.children(0xFFFFFFFF) == [DCIM]
    assert store.children(DCIM) == [FOLDER_HANDLE]
    assert frozenset({0x9110, 0x1016, 0x100C, 0x100D}) == DATA_OUT  # what brings data of its own
