"""Everything the virtual camera can get wrong, met by the real client through pyusb.

Whatever happens, a capture ends with the photo of its own exposure or with a typed error, the
shutter is closed, it was opened at most once, and no time-out is longer than it says. Times are
those of a virtual clock.
"""

from __future__ import annotations

import gc
import threading
import tracemalloc
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import get_args

import pytest

from drivers.ptp.codes import Operation
from drivers.ptp.session import LONGEST_OPERATION_S
from drivers.virtual_camera import (
    RELEASE_BODY,
    CameraExposure,
    FaultScript,
    PlainFilm,
    ScriptedFault,
)
from drivers.virtual_camera.faults import Occasions, WireKind
from pdcd.bench.devices import RawFile
from pdcd.errors import DeviceLost, ExposureError, PdcdError
from tests.ptp_rig import SETTINGS, PtpRig
from tests.sampled import sampled

OPERATIONS = (
    Operation.OPEN_SESSION,
    Operation.GET_DEVICE_INFO,
    Operation.EOS_SET_REMOTE_MODE,
    Operation.EOS_SET_EVENT_MODE,
    Operation.EOS_GET_EVENT,
    Operation.EOS_SET_DEVICE_PROP_VALUE_EX,
    Operation.EOS_PC_HDD_CAPACITY,
    Operation.EOS_BULB_START,
    Operation.EOS_BULB_END,
    Operation.EOS_KEEP_DEVICE_ON,
    Operation.GET_PARTIAL_OBJECT,
    Operation.EOS_TRANSFER_COMPLETE,
    Operation.CLOSE_SESSION,
)

KINDS: tuple[WireKind, ...] = get_args(WireKind)

CAPTURE_S = 4 * LONGEST_OPERATION_S
"""Bound of one capture in which a single operation fails: connect, arm, open, close and fetch."""


def attempt(rig: PtpRig, folder: Path, name: str) -> RawFile | None:
    """One capture as the engine does it: whatever fails, the shutter is asked to close."""
    before = rig.body.shutter.opened
    began_ns = rig.clock.now_ns()
    raw = None
    try:
        rig.connect()
        rig.readout.arm(SETTINGS)
        rig.shutter.open()
        rig.wait(0.5)
        rig.camera.tick()
        rig.wait(0.5)
        rig.shutter.close()
        raw = rig.readout.fetch(folder, name, 60.0)
    except PdcdError as err:
        assert err.message and err.hint
    finally:
        for _ in range(3):  # as often as a rig asks
            try:
                rig.shutter.close()
                break
            except PdcdError:
                continue
    assert rig.body.shutter.opened - before <= 1
    assert (rig.clock.now_ns() - began_ns) * 1e-9 < CAPTURE_S
    return raw


def own_exposure(rig: PtpRig) -> CameraExposure:
    """The exposure that has just ended."""
    return list(rig.body.shutter.exposures)[-1]


def check(rig: PtpRig, folder: Path, name: str, raw: RawFile | None, damaged: bool = False) -> None:
    if raw is not None and not damaged:
        assert rig.is_photo_of(raw, own_exposure(rig))
    names = {path.stem for path in folder.iterdir()}
    assert (name in names) == (raw is not None)
    assert not [path for path in folder.iterdir() if path.suffix == ".part"]


def faults() -> Iterator[tuple[Operation, WireKind, int, int]]:
    """Half of all there are: of operation, kind, first time and how often, any three meet in every
    combination."""
    for n, operation in enumerate(OPERATIONS):
        for m, kind in enumerate(KINDS):
            for first in (1, 2):
                yield operation, kind, first, (1, 1000)[(n + m + first) % 2]


@pytest.mark.parametrize(("operation", "kind", "first", "times"), sampled(list(faults()), 7))
def test_any_fault_of_the_wire(
    operation: Operation, kind: WireKind, first: int, times: int, tmp_path: Path
) -> None:
    rig = PtpRig(FaultScript(wire=(ScriptedFault(kind, operation, first, times),)))
    # The same damage to both readings of a photo is what no client can notice.
    same = kind == "corrupt" and operation == Operation.GET_PARTIAL_OBJECT and times > 1
    raw = attempt(rig, tmp_path, "one")
    check(rig, tmp_path, "one", raw, same)
    reachable = kind != "unplug" and times == 1
    if reachable:
        assert not rig.body.shutter.is_open
    # Afterwards: the cable is back, the fault is over unless it lasts.
    rig.body.replug()
    raw = attempt(rig, tmp_path, "two")
    check(rig, tmp_path, "two", raw, same)
    if reachable:
        assert not rig.body.shutter.is_open
    if times == 1 and raw is None:
        rig.body.replug()
        raw = attempt(rig, tmp_path, "three")
        check(rig, tmp_path, "three", raw)
        assert raw is not None, "a fault that is over must not spoil a third capture"
    rig.disconnect_quietly()


@pytest.mark.parametrize(("silent", "renewed", "moved"), [(1, 0, 0), (2, 1, 0), (3, 2, 1)])
def test_each_rung_of_the_ladder_on_the_bus(silent: int, renewed: int, moved: int) -> None:
    """One try more each time: cancelled, device reset, port reset under a new address."""
    rig = PtpRig(
        FaultScript(wire=(ScriptedFault("deaf", Operation.EOS_KEEP_DEVICE_ON, times=silent),))
    )
    rig.connect()
    sessions, address = rig.camera.session.renewed, rig.usb.address
    rig.camera.tick()
    assert rig.body.kept_on == 1
    assert rig.camera.session.renewed - sessions == renewed
    assert rig.usb.address - address == moved
    rig.disconnect()


def test_the_last_rung_says_to_switch_off(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(wire=(ScriptedFault("deaf", Operation.EOS_KEEP_DEVICE_ON, times=4),)))
    rig.connect()
    with pytest.raises(DeviceLost, match="switch the camera off and on"):
        rig.camera.tick()
    rig.camera.tick()  # off line: nothing to keep alive
    raw = rig.photo(tmp_path, "photo")  # and is found again by the next capture
    assert rig.is_photo_of(raw, own_exposure(rig))
    rig.disconnect()


def test_a_late_photo_is_waited_for(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(file="late", late_s=25.0))
    rig.connect()
    raw = rig.photo(tmp_path, "photo")
    assert rig.is_photo_of(raw, own_exposure(rig))
    rig.disconnect()


def test_a_truncated_photo_is_refused(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(file="truncated"))
    rig.connect()
    with pytest.raises(ExposureError, match="did not come whole"):
        rig.photo(tmp_path, "photo")
    assert list(tmp_path.iterdir()) == [] and rig.body.store.in_ram == 0
    rig.disconnect()


def test_a_photo_that_comes_very_late_is_never_taken_for_another(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(file="late", late_s=100.0))
    rig.connect()
    rig.expose(1.0)
    with pytest.raises(ExposureError, match="no photo came"):
        rig.readout.fetch(tmp_path, "one", 600.0)
    while rig.clock.now_ns() < 90e9:
        with pytest.raises(ExposureError, match="could be taken for the next"):
            rig.readout.arm(SETTINGS)
    rig.wait(30.0)
    rig.readout.arm(SETTINGS)  # it has come, and was thrown away
    assert rig.body.store.in_ram == 0 and rig.body.shutter.opened == 1
    rig.disconnect()


def test_a_photo_that_was_announced_and_not_fetched_is_not_waited_for(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript())
    rig.connect()
    rig.expose(1.0)
    rig.wait(5.0)
    with rig.camera.session.hold():
        rig.camera.poll()  # the photo is announced, and its job fails before it is fetched
    rig.shutter.close()
    rig.readout.arm(SETTINGS)
    assert rig.body.store.in_ram == 0
    rig.photo(tmp_path, "next")
    rig.disconnect()


def test_a_photo_lost_with_the_camera_s_memory_is_not_waited_for_for_ever(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(file="none"))
    rig.connect()
    rig.expose(1.0)
    with pytest.raises(ExposureError, match="no photo came"):
        rig.readout.fetch(tmp_path, "one", 600.0)
    rig.body.unplug()
    with pytest.raises(DeviceLost):
        rig.readout.arm(SETTINGS)
    rig.body.replug()  # switched off and on
    rig.readout.arm(SETTINGS)
    rig.disconnect()


def test_an_unanswered_start_is_one_exposure_at_most(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(wire=(ScriptedFault("mute", Operation.EOS_BULB_START),)))
    rig.connect()
    rig.readout.arm(SETTINGS)
    with pytest.raises(ExposureError, match="did not confirm"):
        rig.shutter.open()
    assert rig.body.shutter.opened == 1 and not rig.body.shutter.is_open
    raw = rig.photo(tmp_path, "next")
    assert rig.body.shutter.opened == 2
    assert rig.is_photo_of(raw, own_exposure(rig))
    rig.disconnect()


@pytest.mark.parametrize("kind", ["busy", "error", "mute"])
@pytest.mark.parametrize(
    "refused",
    [Operation.EOS_SET_REMOTE_MODE, Operation.EOS_SET_EVENT_MODE, Operation.EOS_GET_EVENT],
)
def test_a_camera_that_does_nothing_else_in_an_exposure_is_still_told_to_close(
    refused: Operation, kind: WireKind
) -> None:
    """The session is lost with the shutter open, and no new one gets beyond its modes."""
    rig = PtpRig()
    rig.connect()
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    rig.body.forget_session()
    fault = FaultScript(wire=(ScriptedFault(kind, refused, times=10**6),))
    rig.body._occasions = Occasions(fault)
    with pytest.raises(PdcdError):
        rig.shutter.close()
    assert not rig.body.shutter.is_open and rig.body.shutter.opened == 1
    assert rig.camera.bulb.since_ns is None
    rig.body._occasions = Occasions(FaultScript())
    rig.disconnect_quietly()


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("forgotten", [False, True])
def test_a_camera_that_was_lost_in_an_exposure_is_sought_when_it_is_let_go(
    back: bool, forgotten: bool, caplog: pytest.LogCaptureFixture
) -> None:
    rig = PtpRig()
    rig.connect()
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    rig.body.unplug()
    with pytest.raises(DeviceLost):
        rig.shutter.close()
    if back:
        rig.body.replug()
    if forgotten:  # as at the end of the interpreter
        rig.camera.let_go("shutter")
        assert "camera not left as it should be" in caplog.text
    else:
        with pytest.raises(ExposureError if back else DeviceLost):
            rig.shutter.disconnect()
    assert rig.body.shutter.is_open == (not back) == (rig.camera.bulb.since_ns is not None)
    rig.shutter.disconnect()  # a second time there is nothing to do
    rig.disconnect_quietly()


@pytest.mark.parametrize("calls", [1, 1000])
def test_a_shutter_is_not_taken_for_closed_while_the_camera_is_too_busy_to_close_it(
    calls: int,
) -> None:
    """A new session begins by closing it: an answer that it is busy is none that it did."""
    busy = ScriptedFault("busy", Operation.EOS_BULB_END, first=2, times=calls)
    rig = PtpRig(FaultScript(wire=(busy,)))
    rig.connect()
    rig.readout.arm(SETTINGS)
    rig.shutter.open()
    rig.body.forget_session()
    with pytest.raises(PdcdError):
        rig.shutter.close()
    assert (rig.camera.bulb.since_ns is None) == (not rig.body.shutter.is_open) == (calls == 1)
    rig.body._occasions = Occasions(FaultScript())
    with suppress(ExposureError):  # that the exposure is spoiled, where it was not said before
        rig.shutter.close()
    assert not rig.body.shutter.is_open and rig.body.shutter.opened == 1
    rig.disconnect_quietly()


def test_a_refused_end_is_asked_again(tmp_path: Path) -> None:
    rig = PtpRig(FaultScript(wire=(ScriptedFault("error", Operation.EOS_BULB_END, first=2),)))
    rig.connect()  # the first is sent to close what another program may have left open
    raw = rig.photo(tmp_path, "photo")
    assert rig.is_photo_of(raw, own_exposure(rig)) and not rig.body.shutter.is_open
    rig.disconnect()


@pytest.mark.parametrize("kind", KINDS)
def test_newer_bodies_meet_the_same(kind: WireKind, tmp_path: Path) -> None:
    for operation in (Operation.EOS_REMOTE_RELEASE_ON, Operation.EOS_REMOTE_RELEASE_OFF):
        fault = ScriptedFault(kind, operation, first=2 if "OFF" in operation.name else 1)
        rig = PtpRig(FaultScript(wire=(fault,)), RELEASE_BODY)
        name = operation.name
        check(rig, tmp_path, name, attempt(rig, tmp_path, name))
        if kind != "unplug":
            assert not rig.body.shutter.is_open
        rig.disconnect_quietly()


def test_a_hundred_captures_leave_nothing_behind(tmp_path: Path) -> None:
    film = PlainFilm(lambda exposure: b"II*\0" + repr(exposure).encode())
    rig = PtpRig(film=film)
    rig.connect()

    def capture(count: int) -> None:
        for _ in range(count):
            raw = rig.photo(tmp_path, "photo", 0.1)
            raw.path.unlink()

    capture(30)
    tracemalloc.start(1)
    try:
        capture(20)  # what is kept once is kept now
        gc.collect()
        before_b, handles, threads = (
            tracemalloc.get_traced_memory()[0],
            fds(),
            threading.active_count(),
        )
        capture(80)
        gc.collect()
        grown_b = tracemalloc.get_traced_memory()[0] - before_b
    finally:
        tracemalloc.stop()
    assert rig.body.shutter.opened == 130 and rig.body.store.in_ram == 0
    assert grown_b < 80 * 64, f"{grown_b} bytes"
    assert fds() == handles and threading.active_count() == threads
    rig.disconnect()
    assert "pdcd-ptp-alive" not in [thread.name for thread in threading.enumerate()]


def fds() -> int:
    """Open files of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))
