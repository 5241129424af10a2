"""The virtual camera's parts by themselves: its settings, files, shutter and faults."""

from __future__ import annotations

import logging
import struct
from concurrent.futures import Future
from typing import Any

import pytest

from drivers.ptp.codes import EosEvent, ExposureMode, FocusMode
from drivers.ptp.events import AvailList, ObjectAdded, PlainRecord, PropValue
from drivers.virtual_camera.faults import FaultScript, Occasions, ScriptedFault
from drivers.virtual_camera.films import PlainFilm
from drivers.virtual_camera.model import BULB_BODY, CameraModel
from drivers.virtual_camera.properties import Properties
from drivers.virtual_camera.shutter import (
    DCIM,
    FOLDER_HANDLE,
    ROOT_HANDLE,
    CameraExposure,
    CameraShutter,
    FileStore,
)
from pdcd.bench.clock import VirtualClock

MS = 1_000_000
SECOND = 1000 * MS
CARD, RAM = 2, 4


def properties(model: CameraModel = BULB_BODY, **script: Any) -> Properties:
    return Properties(model, FaultScript(**script))


# Settings.


def test_what_a_sound_body_tells_at_first() -> None:
    told = properties().everything()
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
        0xD11C: CARD,
        0xD11E: 0x20001,
    }
    packed = {r.prop: r.data for r in told if isinstance(r, PropValue) and len(r.data) != 4}
    assert packed[0xD120] == struct.pack("<5I", 1, 16, 6, 0, 4)
    custom = struct.unpack(f"<{len(packed[0xD1A0]) // 4}I", packed[0xD1A0])
    assert custom[0] == len(packed[0xD1A0]) and custom[1] == 2  # bytes in all, and groups
    assert custom[2:11] == (1, 32, 2, 0x101, 1, 0, 0x10F, 1, 0)
    assert custom[11:] == (2, 32, 2, 0x201, 1, 0, 0x202, 1, 0)
    lists = [r for r in told if isinstance(r, AvailList)]
    assert [r.prop for r in lists] == [0xD101, 0xD102, 0xD103, 0xD106, 0xD11C, 0xD120]
    assert lists[-1] == AvailList(0xD120, (), BULB_BODY.image_formats)
    assert len(told) == len(values) + len(packed) + len(lists)


@pytest.mark.parametrize(
    ("script", "changed"),
    [
        ({"dial": ExposureMode.BULB}, {0xD105: 4, 0xD102: 0x0C}),
        ({"dial": ExposureMode.PROGRAM}, {0xD105: 0}),
        ({"focus": FocusMode.AI_SERVO}, {0xD108: 1}),
        ({"battery": 1}, {0xD111: 1}),
        ({"buffer_full": True}, {0xD11B: 0}),
    ],
)
def test_what_is_wrong_with_a_body_is_told(script: dict[str, Any], changed: dict[int, int]) -> None:
    sound, other = properties(), properties(**script)
    differ = {p: other[p] for p in sound.lists | {0xD105: (), 0xD108: (), 0xD111: (), 0xD11B: ()}
              if other[p] != sound[p]}  # fmt: skip
    assert differ == changed
    manual = script.get("dial", ExposureMode.MANUAL) is ExposureMode.MANUAL
    assert (other.lists[0xD101] != ()) == (other.lists[0xD102] != ()) == manual
    assert other.lists[0xD103] == BULB_BODY.isos


def test_noise_reduction_is_a_custom_function() -> None:
    record = properties(long_exposure_nr=True).record(0xD1A0)
    assert isinstance(record, PropValue)
    assert struct.pack("<3I", 0x201, 1, 2) in record.data


def u32(value: int) -> bytes:
    return struct.pack("<I", value)


def test_a_setting_is_taken_where_it_is_offered() -> None:
    made = properties()
    assert made.put(0xD103, u32(0x50)) and made.iso == 200
    assert not made.put(0xD103, u32(0x40)) and made.iso == 200
    assert not made.put(0xD103, b"\x48") and not made.put(0xD103, u32(0x48) + b"\0")
    assert not made.put(0xD111, u32(2))  # nobody sets the battery
    assert made.put(0xD103, u32(0)) and made.iso == 100  # the camera chooses
    jpeg = BULB_BODY.image_formats[0]
    assert made.put(0xD120, jpeg) and made.record(0xD120) == PropValue(0xD120, jpeg)
    assert made.put(0xD120, b"\1\0\0\0") is False
    assert made.put(0xD111, u32(2)) is made.put(0xD103, u32(0x40)) is False
    assert made.record(0xD120) == PropValue(0xD120, jpeg)
    assert made.has(0xD103) and made.has(0xD120) and not made.has(0xD999)
    assert made.put(0xD101, u32(0x38)) and made.f_number == 8.0
    lensless = properties(CameraModel(BULB_BODY.info, apertures=()))
    assert lensless.f_number is None and lensless[0xD101] == 0


@pytest.mark.parametrize(
    ("code", "seconds"), [(0x10, 30.0), (0x18, 15.0), (0x38, 30.0 / 32), (0x98, 30.0 / 2**17)]
)
def test_eight_codes_halve_the_time(code: int, seconds: float) -> None:
    made = properties(CameraModel(BULB_BODY.info, shutter_speeds=(0x0C, 0x04, code)))
    assert not made.bulb
    assert made.put(0xD102, u32(code)) and made.exposure_s == pytest.approx(seconds)
    for bulb in (0x0C, 0x04):
        made.put(0xD102, u32(bulb))
        assert made.bulb


def test_shots_are_those_of_the_card_or_of_the_memory_that_is_free() -> None:
    made = properties()
    assert made.on_card
    assert not made.count_shots(pc_has_room=False, in_ram=3) and made[0xD11B] == 92
    assert made.put(0xD11C, u32(RAM)) and not made.on_card
    assert made.count_shots(pc_has_room=False, in_ram=0) and made[0xD11B] == 0
    found = [(made.count_shots(pc_has_room=True, in_ram=n), made[0xD11B]) for n in (0, 0, 3, 5, 7)]
    assert found == [(True, 5), (False, 5), (True, 2), (True, 0), (False, 0)]
    full = properties(buffer_full=True)
    assert not full.count_shots(pc_has_room=True, in_ram=0) and full[0xD11B] == 0


# Files.


def test_files_are_numbered_and_announced() -> None:
    store = FileStore()
    card = store.add(b"abc", on_card=True, announced_bytes=5)
    ram = store.add(b"xyz", on_card=False, announced_bytes=3)
    assert card == ObjectAdded(
        0x91900011, 0xB103, 5, "IMG_0001.CR2", True, storage=0x20001, parent=FOLDER_HANDLE
    )
    assert ram == ObjectAdded(
        0x91900021, 0xB103, 3, "IMG_0002.CR2", False, storage=0, parent=ROOT_HANDLE
    )
    assert store.in_ram == 1
    assert store.everything == [DCIM, FOLDER_HANDLE, card.handle]
    info = store.info(card.handle)
    assert info is not None
    assert (info.storage, info.format, info.size_bytes, info.name, info.parent) == (
        0x20001, 0xB103, 5, "IMG_0001.CR2", FOLDER_HANDLE,
    )  # fmt: skip
    assert store.files[ram.handle].info.parent == ROOT_HANDLE
    assert store.info(7) is None


def test_folders_are_those_of_a_canon_card() -> None:
    store = FileStore()
    assert (ROOT_HANDLE, DCIM, FOLDER_HANDLE) == (0, 0x41000000, 0x41900000)
    found = [store.info(DCIM), store.info(FOLDER_HANDLE)]
    assert [(i.name, i.parent, i.format, i.size_bytes, i.storage) for i in found if i] == [
        ("DCIM", ROOT_HANDLE, 0x3001, 0, 0x20001), ("100CANON", DCIM, 0x3001, 0, 0x20001),
    ]  # fmt: skip
    assert store.children(0) == store.children(0xFFFFFFFF) == [DCIM]
    assert store.children(DCIM) == [FOLDER_HANDLE]
    assert store.children(FOLDER_HANDLE) == store.children(12345) == []


def test_names_begin_again_after_9999() -> None:
    store = FileStore()
    store._count = 9997
    names = [store.add(b"", on_card=True, announced_bytes=0).name for _ in range(3)]
    assert names == ["IMG_9998.CR2", "IMG_9999.CR2", "IMG_0001.CR2"]


# The shutter.


class Bench:
    """A shutter on film that tells which exposure it is of."""

    def __init__(self, develop: Any = None, film: Any = None, **script: Any) -> None:
        self.clock, self.store = VirtualClock(), FileStore()
        film = film or PlainFilm(lambda exposure: b"%d" % (exposure.close_ns - exposure.open_ns))
        given = () if develop is None else (develop,)
        self.shutter = CameraShutter(self.clock, film, FaultScript(**script), self.store, *given)
        self.t0 = self.clock.now_ns()

    def at(self, ms: float) -> None:
        self.clock.sleep_until_ns(self.t0 + round(ms * MS))

    def files(self) -> list[int]:
        """Sizes that are announced now."""
        return [r.size_bytes for r in self.shutter.records() if isinstance(r, ObjectAdded)]


def test_an_exposure_from_its_order_to_its_file() -> None:
    bench = Bench()
    shutter = bench.shutter
    assert not shutter.is_open and not shutter.busy and not shutter.has_news
    shutter.open(200, 5.6, on_card=True)
    assert shutter.is_open and shutter.busy and shutter.opened == 1
    bench.at(500)
    shutter.close()
    assert not shutter.is_open and shutter.busy and not shutter.has_news
    assert list(shutter.exposures) == [CameraExposure(bench.t0, bench.t0 + 500 * MS, 200, 5.6)]
    bench.at(699.999)
    assert shutter.busy and bench.files() == []
    bench.at(700)  # a fifth of a second for the readout
    assert not shutter.busy and shutter.has_news
    assert bench.files() == [9] and bench.files() == [] and not shutter.has_news
    ((stored),) = bench.store.files.values()
    assert (stored.data, stored.on_card) == (b"500000000", True)
    shutter.close()
    assert len(shutter.exposures) == 1


def test_a_timed_exposure_ends_by_itself() -> None:
    bench = Bench()
    bench.shutter.open(100, None, on_card=False, for_s=0.25)
    bench.at(249.999)
    assert bench.shutter.is_open
    assert bench.shutter.records() == []  # its seconds are not told
    bench.at(250)
    assert not bench.shutter.is_open
    (exposure,) = bench.shutter.exposures
    assert (exposure.close_ns - exposure.open_ns, exposure.f_number) == (250 * MS, None)
    bench.at(450)
    assert bench.files() == [9]
    (stored,) = bench.store.files.values()
    assert not stored.on_card


def test_a_bulb_tells_each_second_once() -> None:
    bench = Bench()
    bench.shutter.open(100, None, on_card=False)
    told: list[tuple[float, int]] = []
    for ms in (0, 999.999, 1000, 1500, 2999, 3000, 3001):
        bench.at(ms)
        for record in bench.shutter.records():
            assert isinstance(record, PlainRecord) and record.code == EosEvent.BULB_EXPOSURE_TIME
            told.append((ms, *struct.unpack("<I", record.data)))
    assert told == [(1000, 1), (2999, 2), (3000, 3)]
    bench.shutter.close()
    bench.shutter.open(100, None, on_card=False)
    bench.at(4001)
    again = [r.data for r in bench.shutter.records() if isinstance(r, PlainRecord)]
    assert again == [u32(1)]


@pytest.mark.parametrize(
    ("script", "ready_ms", "due_ms", "sizes"),
    [
        ({}, 1200, 1200, [10]),
        ({"long_exposure_nr": True}, 2200, 2200, [10]),  # a dark one of the same length
        ({"file": "late", "late_s": 3.0}, 1200, 4200, [10]),
        ({"file": "twice"}, 1200, 1200, [10, 10]),
        ({"file": "truncated"}, 1200, 1200, [10]),
        ({"file": "none"}, 1200, 1200, []),
    ],
)
def test_files_are_announced_when_they_are_due(
    script: dict[str, Any], ready_ms: float, due_ms: float, sizes: list[int]
) -> None:
    bench = Bench(**script)
    bench.shutter.open(100, None, on_card=True)
    bench.at(1000)
    bench.shutter.close()
    bench.at(ready_ms - 0.001)
    assert bench.shutter.busy
    bench.at(due_ms - 0.001)
    assert bench.shutter.busy == (due_ms == ready_ms)
    assert not bench.shutter.has_news and bench.files() == []
    bench.at(due_ms)
    assert not bench.shutter.busy
    assert bench.shutter.has_news == bool(sizes)
    assert bench.files() == sizes
    kept = [stored.data for stored in bench.store.files.values()]
    whole = b"1000000000"
    assert kept == ([whole[:5]] if script.get("file") == "truncated" else [whole][: len(sizes)])


def test_a_file_that_is_still_being_made_keeps_the_camera_busy() -> None:
    made: Future[bytes] = Future()
    bench = Bench(develop=lambda make: made)
    bench.shutter.open(100, None, on_card=True)
    bench.shutter.close()
    bench.at(5000)
    assert bench.shutter.busy and not bench.shutter.has_news and bench.files() == []
    made.set_result(b"abc")
    assert bench.shutter.has_news and not bench.shutter.busy and bench.files() == [3]


def test_a_film_that_fails_makes_no_file_and_the_camera_goes_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    failed: Future[bytes] = Future()
    failed.set_exception(RuntimeError("torn"))
    bench = Bench(develop=lambda make: failed)
    bench.shutter.open(100, None, on_card=True)
    with caplog.at_level(logging.ERROR):
        bench.shutter.close()
    assert "no file was made error=RuntimeError: torn" in caplog.text
    bench.at(1000)
    assert not bench.shutter.busy and bench.files() == []
    bench.shutter.open(100, None, on_card=True)
    assert bench.shutter.opened == 2


def test_the_last_sixteen_exposures_are_remembered() -> None:
    bench = Bench()
    for _ in range(20):
        bench.shutter.open(100, None, on_card=True)
        bench.shutter.close()
    assert len(bench.shutter.exposures) == 16


# Faults.


def test_a_fault_meets_the_calls_that_it_names_and_the_first_wins() -> None:
    faults = (
        ScriptedFault("busy", 1, first=2, times=2),
        ScriptedFault("error", 1, first=3, times=2),
    )
    occasions = Occasions(FaultScript(wire=faults))
    assert occasions.meet(2) is None
    met = [occasions.meet(1) for _ in range(6)]
    assert met == [None, "busy", "busy", "error", None, None]
    assert (ScriptedFault("busy", 1).first, ScriptedFault("busy", 1).times) == (1, 1)


def test_a_sound_camera_is_set_for_bulb() -> None:
    sound = FaultScript()
    assert (sound.dial, sound.focus, sound.battery) == (ExposureMode.MANUAL, FocusMode.MANUAL, 2)
    assert (sound.file, sound.late_s, sound.wire) == ("normal", 20.0, ())
    assert not sound.long_exposure_nr and not sound.buffer_full
    with pytest.raises(AttributeError):
        sound.battery = 1  # type: ignore[misc]
