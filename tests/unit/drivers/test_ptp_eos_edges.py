"""The camera that both drivers share, and the readout: waits, orders and what is believed."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.ptp import eos, files
from drivers.ptp.codes import Operation, Property, ResponseCode
from drivers.ptp.eos import EosCamera
from drivers.ptp.events import EosRecord, ObjectAdded, PlainRecord, PropValue, pack_events
from drivers.ptp.faults import TransactionMismatch
from drivers.ptp.readout import PtpReadout
from drivers.ptp.transport import TransactionReply
from drivers.ptp.values import list_f_numbers, list_isos, list_setup_faults
from drivers.virtual_camera import FaultScript
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import Config, LimitsConfig
from pdcd.errors import ConfigError, ExposureError
from tests.ptp_rig import SETTINGS, PtpRig

MS = 1_000_000
BUSY = ResponseCode.DEVICE_BUSY
PING = Operation.EOS_KEEP_DEVICE_ON


@pytest.fixture
def rig() -> Iterator[PtpRig]:
    rig = PtpRig()
    rig.connect()
    yield rig
    rig.disconnect_quietly()


def answer(code: int, data: bytes = b"") -> TransactionReply:
    return TransactionReply(code, (), memoryview(data))


class Calls:
    """Stands before the session of a camera: answers some operations itself, notes all."""

    def __init__(self, rig: PtpRig, answers: dict[Operation, list[Any]]) -> None:
        self.real = rig.camera.session.call
        self.answers = answers
        self.rig = rig
        rig.camera.session.call = self  # type: ignore[method-assign]
        self.done: list[tuple[int, Operation]] = []

    def __call__(self, code: Operation, *params: int, **more: Any) -> TransactionReply:
        self.done.append((self.rig.clock.now_ns(), code))
        if self.answers.get(code):
            found = self.answers[code].pop(0)
            if isinstance(found, Exception):
                raise found
            assert isinstance(found, TransactionReply)
            return found
        return self.real(code, *params, **more)

    def times(self, code: Operation) -> list[int]:
        return [at for at, one in self.done if one == code]


def test_a_busy_camera_is_asked_again_ever_more_slowly_for_five_seconds(rig: PtpRig) -> None:
    calls = Calls(rig, {PING: [answer(BUSY)] * 100})
    before_ns = rig.clock.now_ns()
    assert rig.camera.order(PING).code == BUSY
    at_ms = [(at - before_ns) // MS for at in calls.times(PING)]
    assert at_ms == [0, 50, 150, 350, 750, 1550, 2350, 3150, 3950, 4750, 5550]
    assert len(calls.times(Operation.EOS_GET_EVENT)) >= 10  # its events are heard meanwhile


def test_a_camera_that_is_done_being_busy_is_not_asked_again(rig: PtpRig) -> None:
    calls = Calls(rig, {PING: [answer(BUSY), answer(0x2002)]})
    assert rig.camera.order(PING).code == 0x2002
    assert len(calls.times(PING)) == 2


def test_events_are_heard_until_there_are_none_and_64_times_at_most(rig: PtpRig) -> None:
    record = pack_events([PropValue.of(0xD103, 0x50)])
    calls = Calls(rig, {Operation.EOS_GET_EVENT: [answer(0x2001, record)] * 1000})
    rig.camera.poll()
    assert len(calls.done) == 64 and rig.camera.values[0xD103] == 0x50
    calls.done.clear()
    calls.answers[Operation.EOS_GET_EVENT] = [answer(0x2001, record), answer(BUSY, record)]
    rig.camera.poll()
    assert len(calls.done) == 2  # there will be another poll


def test_a_fault_of_the_program_is_no_lost_event(
    rig: PtpRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def parse(data: object) -> Any:
        raise RuntimeError("a bug")

    monkeypatch.setattr(eos, "parse_events", parse)
    with pytest.raises(RuntimeError, match="a bug"):
        rig.camera.poll()
    monkeypatch.undo()


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


def test_a_photo_in_memory_is_there_as_far_as_the_camera_tells(rig: PtpRig) -> None:
    assert not rig.camera.discard(ObjectAdded(7, 0xB103, 5, "IMG_0001.CR2", False))


def test_a_value_that_is_set_already_is_not_set_again(rig: PtpRig) -> None:
    calls = Calls(rig, {})
    rig.camera.set_value(Property.ISO, rig.camera.values[Property.ISO], "this ISO")
    assert calls.done == []


def test_a_camera_that_tells_no_settings_is_out_of_step_after_a_second(rig: PtpRig) -> None:
    Calls(rig, {Operation.EOS_GET_EVENT: [answer(0x2001, pack_events([]))] * 1000})
    before_ns = rig.clock.now_ns()
    with pytest.raises(TransactionMismatch, match="does not tell its settings"):
        rig.camera._set_modes()
    assert rig.clock.now_ns() - before_ns == 20 * 50 * MS
    assert not rig.camera.values and not rig.camera.choices


def test_a_body_that_refuses_a_mode_is_named_with_its_answer(rig: PtpRig) -> None:
    Calls(rig, {Operation.EOS_SET_EVENT_MODE: [answer(0x2005)]})
    with pytest.raises(ExposureError, match=r"EOS_SET_EVENT_MODE is refused: 0x2005 OPERATION_NOT"):
        rig.camera._set_modes()


def test_an_exposure_is_overdue_ten_seconds_after_the_longest(rig: PtpRig) -> None:
    limit_s = rig.context.config.limits.max_exposure_s + 10.0
    rig.shutter.open()
    open_ns = rig.camera.bulb.since_ns
    assert open_ns is not None
    rig.clock.sleep_until_ns(open_ns + round(limit_s * 1e9))
    rig.camera.tick()
    assert rig.body.shutter.is_open
    rig.clock.sleep_until_ns(rig.clock.now_ns() + 1)
    rig.camera.tick()
    assert not rig.body.shutter.is_open
    with pytest.raises(ExposureError, match=r"open for longer than limits\.max_exposure_s"):
        rig.shutter.close()


def test_an_exposure_that_was_told_of_is_ended_by_its_own_time(rig: PtpRig) -> None:
    rig.shutter.expect_exposure(2.0, 34.0)
    rig.shutter.open()
    open_ns = rig.camera.bulb.since_ns
    assert open_ns is not None
    rig.clock.sleep_until_ns(open_ns + 34_000_000_000)
    rig.camera.tick()
    assert rig.body.shutter.is_open
    rig.clock.sleep_until_ns(rig.clock.now_ns() + 1)
    rig.camera.tick()
    assert not rig.body.shutter.is_open
    with pytest.raises(ExposureError, match="longer than the 34 s that it can take"):
        rig.shutter.close()
    rig.readout.arm(CameraSettings(100, None))
    rig.shutter.open()  # of this one nothing is known
    rig.clock.sleep_until_ns(rig.clock.now_ns() + 60_000_000_000)
    rig.camera.tick()
    assert rig.body.shutter.is_open
    rig.shutter.close()


def test_no_exposure_is_told_to_last_beyond_the_limit_of_all(rig: PtpRig) -> None:
    rig.shutter.expect_exposure(2.0, 1e9)
    rig.shutter.open()
    rig.clock.sleep_until_ns(rig.clock.now_ns() + 611_000_000_000)
    rig.camera.tick()
    assert not rig.body.shutter.is_open


def test_exposures_without_a_longest_one_are_not_overdue_after_a_day() -> None:
    longest = LimitsConfig(max_exposure_s=float("inf"))
    context = DriverContext(Config(limits=longest), VirtualClock())
    camera = EosCamera.of(context)
    camera.bulb.since_ns = context.clock.now_ns()
    context.clock.sleep_until_ns(10**14)
    assert not camera.bulb.overdue(camera._longest_ns)


def test_a_tick_without_a_session_does_nothing(rig: PtpRig) -> None:
    rig.camera.session.close()
    calls = Calls(rig, {})
    rig.camera.tick()
    assert calls.done == []
    assert rig.camera.lock.acquire(blocking=False)
    rig.camera.lock.release()


def test_a_closed_shutter_is_not_cut_short(rig: PtpRig) -> None:
    calls = Calls(rig, {})
    rig.camera.cut_short("no reason")
    assert calls.done == []
    rig.shutter.open()
    rig.shutter.close()


def test_users_come_and_go_and_the_shutter_is_one_of_them(rig: PtpRig) -> None:
    assert rig.camera.releases
    rig.shutter.disconnect()
    assert not rig.camera.releases and rig.body.session_open
    said = rig.camera.open("somebody")
    assert set(said) == {"model", "serial", "firmware", "place", "release"}
    assert (said["firmware"], said["release"]) == ("3-1.0.4", "bulb")
    rig.readout.disconnect()
    assert rig.body.session_open
    rig.camera.close("somebody")
    rig.camera.close("somebody")
    assert not rig.body.session_open
    assert EosCamera.of(rig.context) is rig.camera


# The readout.


def test_a_readout_arms_with_what_the_camera_offers(rig: PtpRig) -> None:
    with pytest.raises(ConfigError, match=r"ISO 50 is not offered \(take one of 100, 200"):
        rig.readout.arm(CameraSettings(50, 8.0))
    with pytest.raises(ConfigError, match=r"f/7 is not offered \(take one of 5\.6, 6\.3"):
        rig.readout.arm(CameraSettings(100, 7.0))
    with pytest.raises(ExposureError, match="not armed"):
        rig.readout.fetch(Path("/nowhere"), "shot", 1.0)
    assert PtpReadout.maturity == "experimental"


@pytest.mark.parametrize(("exposed_s", "waits_s"), [(0.0, 30.0), (10.0, 50.0), (40.0, 60.0)])
def test_a_photo_is_waited_for_twice_its_exposure_and_half_a_minute(
    tmp_path: Path, exposed_s: float, waits_s: float
) -> None:
    rig = PtpRig(FaultScript(file="none"))
    rig.connect()
    rig.readout.arm(SETTINGS)
    rig.wait(exposed_s)
    before_ns = rig.clock.now_ns()
    with pytest.raises(ExposureError, match=rf"no photo came within {waits_s:.0f} s"):
        rig.readout.fetch(tmp_path, "shot", 60.0)
    waited_s = (rig.clock.now_ns() - before_ns) * 1e-9
    assert waits_s <= waited_s <= waits_s + 0.1
    assert rig.camera.bulb.owed  # it may still come
    rig.disconnect_quietly()


@pytest.mark.parametrize(("late_s", "remarked"), [(4.0, False), (6.0, True)])
def test_a_photo_that_takes_longer_than_its_exposure_and_five_seconds_is_remarked_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, late_s: float, remarked: bool
) -> None:
    rig = PtpRig(FaultScript(file="late", late_s=late_s))
    rig.connect()
    with caplog.at_level(logging.WARNING):
        rig.photo(tmp_path, "shot")
    assert ("photo came late" in caplog.text) == remarked
    assert not rig.camera.bulb.owed
    rig.disconnect_quietly()


def test_a_photo_of_another_session_is_not_taken(rig: PtpRig, tmp_path: Path) -> None:
    rig.expose()
    rig.camera.renew()
    with pytest.raises(ExposureError, match="connection was lost since the camera was armed"):
        rig.readout.fetch(tmp_path, "shot", 60.0)
    assert not list(tmp_path.iterdir())


def test_a_stray_photo_is_waited_for_a_quarter_of_a_minute(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(file="none"))
    rig.connect()
    rig.expose()
    before_ns = rig.clock.now_ns()
    with pytest.raises(ExposureError, match="has not come and could be taken for the next"):
        rig.readout.arm(SETTINGS)
    waited_s = (rig.clock.now_ns() - before_ns) * 1e-9
    assert 15.0 <= waited_s <= 15.2
    rig.disconnect_quietly()


# Files.


@pytest.mark.parametrize(
    ("name", "kind", "suffix"),
    [
        ("IMG_0001.CR2", 0xB103, ".cr2"),
        ("a.Cr3", 0, ".cr3"),
        ("a.crw", 0, ".crw"),
        ("a.dng", 0, ".dng"),
        ("a.jpg", 0xB103, None),
        ("IMG", 0xB103, ".cr2"),
        ("IMG", 0xB101, ".crw"),
        ("IMG", 0x3801, None),
    ],
)
def test_raw_files_are_known_by_their_suffix_or_their_format(
    name: str, kind: int, suffix: str | None
) -> None:
    assert files.suffix_of(ObjectAdded(1, kind, 5, name, True)) == suffix


@pytest.mark.parametrize(
    ("head", "raw"),
    [
        (b"II*\0", True),
        (b"MM\0*", True),
        (b"II\x1a\0", True),
        (b"\0\0\0\x18ftypcrx ", True),
        (b"\xff\xd8\xff\xe0", False),
        (b"\0\0\0\x18ftypheic", False),
    ],
)
def test_raw_files_are_known_by_their_first_bytes(rig: PtpRig, head: bytes, raw: bool) -> None:
    data = head.ljust(40, b"x")
    photo = ObjectAdded(7, 0xB103, 40, "a.cr2", False)
    read = Operation.GET_PARTIAL_OBJECT
    Calls(rig, {read: [answer(0x2001, data)] * 2})
    taken: list[bytes] = []
    if raw:
        found = files._copy(rig.camera, photo, lambda block: taken.append(bytes(block)))
        assert found == hashlib.sha256(data).hexdigest() and taken == [data]
    else:
        with pytest.raises(ExposureError, match="does not begin as a RAW file does"):
            files._copy(rig.camera, photo, lambda block: taken.append(bytes(block)))
        assert taken == []


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ([answer(0x2001, b"II*\0" + bytes(37))], "41 bytes came at byte 0, not 40"),
        ([answer(0x2001, b"")], "0 bytes came at byte 0, not 40"),
        ([answer(0x2002)], "refused at byte 0: 0x2002 GENERAL_ERROR"),
        ([answer(0x2001, b"II*\0" + bytes(16)), answer(0x2009)], "refused at byte 20: 0x2009"),
    ],
)
def test_what_is_not_whole_says_where_it_broke(
    rig: PtpRig, answers: list[TransactionReply], words: str
) -> None:
    Calls(rig, {Operation.GET_PARTIAL_OBJECT: answers})
    photo = ObjectAdded(7, 0xB103, 40, "a.cr2", False)
    with pytest.raises(ExposureError, match=rf"a\.cr2 of 40 bytes did not come whole: {words}"):
        files._copy(rig.camera, photo, lambda block: None)


def test_an_object_that_is_unknown_or_empty(rig: PtpRig, tmp_path: Path) -> None:
    Calls(rig, {Operation.GET_PARTIAL_OBJECT: [answer(0x2009)]})
    path = tmp_path / "a.cr2"
    unknown = ObjectAdded(7, 0xB103, 40, "a.cr2", False)
    assert files.store_photo(rig.camera, unknown, path) is None
    empty = ObjectAdded(7, 0xB103, 0, "a.cr2", False)
    with pytest.raises(ExposureError, match="it is empty"):
        files.store_photo(rig.camera, empty, path)
    assert not list(tmp_path.iterdir())


# Settings in the words of dials.


def test_lists_are_in_the_order_of_their_values() -> None:
    assert list_isos((0x50, 0x00, 0x48, 0x99)) == {100: 0x48, 200: 0x50}
    assert list(list_isos((0x50, 0x48))) == [100, 200]
    assert list_f_numbers((0x38, 0x14, 0x15, 0xFF)) == {1.8: 0x14, 8.0: 0x38}
    assert list(list_f_numbers((0x38, 0x14))) == [1.8, 8.0]


@pytest.mark.parametrize(
    ("values", "custom", "words"),
    [
        ({}, {}, None),
        ({0xD105: 3, 0xD108: 3, 0xD111: 1, 0xD11B: 5}, {0x201: 0}, None),
        ({0xD105: 4}, {}, None),
        ({0xD105: 0}, {}, "mode dial"),
        ({0xD105: 2}, {}, "mode dial"),
        ({0xD108: 0}, {}, "autofocus"),
        ({0xD111: 0}, {}, "battery"),
        ({0xD11B: 0}, {}, "no room on the card: change it"),
        ({}, {0x201: 1}, "noise reduction"),
        ({}, {0x201: 2}, "noise reduction"),
    ],
)
def test_what_is_to_be_changed_is_said_and_what_was_not_told_is_not_judged(
    values: dict[int, int], custom: dict[int, int], words: str | None
) -> None:
    found = list_setup_faults(values, custom, "card")
    assert len(found) == (words is not None)
    assert words is None or words in found[0]


def test_memory_without_room_is_another_matter() -> None:
    assert list_setup_faults({0xD11B: 0}, {}, "ram") == [
        "there is no room in the camera: switch it off and on"
    ]
