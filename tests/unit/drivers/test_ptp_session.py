"""The recovery ladder, rung by rung, on a scripted camera below the session.

The script says for each operation what becomes of it, time after time; what is not scripted goes
well. So each test says how ill the camera is, and looks at what was done about it and no more.
"""

from __future__ import annotations

from collections import defaultdict, deque
from dataclasses import dataclass, field
from typing import Any

import pytest

from drivers.ptp import session as module
from drivers.ptp.codes import Operation, ResponseCode
from drivers.ptp.datasets import DeviceInfo
from drivers.ptp.faults import (
    DeviceGone,
    EndpointStall,
    NoAnswer,
    TransactionMismatch,
    WireFault,
    WireTimeout,
)
from drivers.ptp.session import LONGEST_OPERATION_S, PtpSession
from drivers.ptp.transport import TRANSACTION_S, TransactionReply
from pdcd.bench.clock import VirtualClock
from pdcd.errors import ConfigError, DeviceLost

INFO = DeviceInfo("Canon Inc.", "Canon EOS 450D", "3-1.0.4", "0001", (0x1001,))
PING = Operation.EOS_KEEP_DEVICE_ON
SHOOT = Operation.EOS_BULB_START


@dataclass
class Camera:
    """One device on the bus: what happens to it, and what it was asked."""

    serial: str = "0001"
    on_bus: bool = True
    script: dict[object, deque[WireFault | int]] = field(default_factory=lambda: defaultdict(deque))
    seen: list[str] = field(default_factory=list)
    closed: int = 0
    comes_back_ns: int | None = None
    idVendor: int = 0x04A9  # noqa: N815 - pyusb's names
    idProduct: int = 0x3145  # noqa: N815
    bus: int = 1
    address: int = 5

    def fails(self, what: object, *outcomes: WireFault | int) -> None:
        self.script[what].extend(outcomes)

    def meet(self, what: object) -> int:
        self.seen.append(what.name if isinstance(what, Operation) else str(what))
        outcome = self.script[what].popleft() if self.script[what] else ResponseCode.OK
        if isinstance(outcome, WireFault):
            raise outcome
        return outcome


class Bench:
    """The session's module with a scripted bus below it."""

    def __init__(self, patch: pytest.MonkeyPatch, *cameras: Camera) -> None:
        self.clock = VirtualClock()
        self.cameras = list(cameras)
        self.restored = 0
        bench = self

        class Transport:
            def __init__(self, camera: Camera, clock: VirtualClock) -> None:
                self.camera = camera
                self.name = f"camera {camera.serial}"

            def restart_ids(self) -> None: ...

            def transact(
                self,
                code: int,
                params: tuple[int, ...] = (),
                data: bytes | None = None,
                timeout_s: float = TRANSACTION_S,
            ) -> TransactionReply:
                try:
                    answer = self.camera.meet(code)
                except WireTimeout:
                    bench.sleep(timeout_s)
                    raise
                info = DeviceInfo(**{**INFO.__dict__, "serial": self.camera.serial}).pack()
                found = info if code == Operation.GET_DEVICE_INFO else b""
                return TransactionReply(answer, (), memoryview(found))

            def back_in_step(self) -> None:
                bench.sleep(1.0)
                self.camera.meet("cancel")

            def device_reset(self) -> None:
                self.camera.meet("reset")

            def usb_reset(self) -> None:
                self.close()
                self.camera.meet("usb reset")
                self.camera.address += 1

            def close(self) -> None:
                self.camera.closed += 1

        def find(backend: Any, usb_id: Any) -> list[Camera]:
            for camera in bench.cameras:
                if (
                    camera.comes_back_ns is not None
                    and bench.clock.now_ns() >= camera.comes_back_ns
                ):
                    camera.on_bus = True
            return [camera for camera in bench.cameras if camera.on_bus]

        patch.setattr(module, "Transport", Transport)
        patch.setattr(module, "UsbPort", lambda camera: camera)
        patch.setattr(module, "find_cameras", find)

    def sleep(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * 1e9))

    def session(self, serial: str | None = None) -> PtpSession:
        def restore() -> None:
            self.restored += 1

        made = PtpSession(None, self.clock, restore, serial=serial)
        made.open()
        for camera in self.cameras:
            camera.seen.clear()
        return made


@pytest.fixture
def camera() -> Camera:
    return Camera()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, camera: Camera) -> Bench:
    return Bench(monkeypatch, camera)


BEGIN = ["OPEN_SESSION", "GET_DEVICE_INFO"]


def test_a_camera_that_is_well_is_asked_once(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    assert session.call(PING).code == ResponseCode.OK
    assert camera.seen == [PING.name] and bench.restored == 1
    session.open()
    assert bench.restored == 1


@pytest.mark.parametrize("fault", [WireTimeout("x"), EndpointStall("x"), TransactionMismatch("x")])
def test_rung_2_cancels_and_repeats(bench: Bench, camera: Camera, fault: WireFault) -> None:
    session = bench.session()
    camera.fails(PING, fault)
    assert session.call(PING).code == ResponseCode.OK
    assert camera.seen == [PING.name, "cancel", PING.name]
    assert bench.restored == 1


def test_rung_3_resets_the_device_and_opens_anew(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    camera.fails(PING, WireTimeout("x"))
    camera.fails("cancel", EndpointStall("x"))
    assert session.call(PING).code == ResponseCode.OK
    assert camera.seen == [PING.name, "cancel", "reset", *BEGIN, PING.name]
    assert bench.restored == 2 and session.renewed == 2


def test_rung_4_resets_the_port_and_finds_the_camera_again(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    camera.fails(PING, WireTimeout("x"))
    camera.fails("cancel", WireTimeout("x"))
    camera.fails("reset", WireTimeout("x"))
    assert session.call(PING).code == ResponseCode.OK
    assert camera.seen == [PING.name, "cancel", "reset", "usb reset", *BEGIN, PING.name]
    assert camera.address == 6


def test_an_operation_that_fails_again_climbs_one_rung_each_time(
    bench: Bench, camera: Camera
) -> None:
    session = bench.session()
    camera.fails(PING, *[WireTimeout("x")] * 3)
    assert session.call(PING).code == ResponseCode.OK
    assert camera.seen == [
        *(PING.name, "cancel"),
        *(PING.name, "reset", *BEGIN),
        *(PING.name, "usb reset", *BEGIN),
        PING.name,
    ]


def test_rung_5_gives_up_in_time_and_the_next_open_starts_afresh(
    bench: Bench, camera: Camera
) -> None:
    session = bench.session()
    camera.fails(PING, *[WireTimeout("x")] * 4)
    began_ns = bench.clock.now_ns()
    with pytest.raises(DeviceLost, match="off and on"):
        session.call(PING)
    assert (bench.clock.now_ns() - began_ns) * 1e-9 < LONGEST_OPERATION_S
    assert not session.is_open and camera.closed == 2  # before the port's reset, and at the end
    with pytest.raises(DeviceLost, match="off line"):
        session.call(PING)
    session.open()
    assert session.call(PING).code == ResponseCode.OK


def test_a_dead_camera_at_every_rung_gives_up_in_time(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    for what in (PING, "cancel", Operation.OPEN_SESSION):
        camera.fails(what, *[WireTimeout("x")] * 100)
    began_ns = bench.clock.now_ns()
    with pytest.raises(DeviceLost, match="off and on"):
        session.call(PING)
    assert (bench.clock.now_ns() - began_ns) * 1e-9 < LONGEST_OPERATION_S


def test_what_must_happen_once_is_never_repeated(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    camera.fails(SHOOT, WireTimeout("x"))
    with pytest.raises(NoAnswer):
        session.call(SHOOT, once=True)
    assert camera.seen == [SHOOT.name, "cancel"]


def test_a_session_that_the_camera_forgot_is_opened_anew(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    camera.fails(SHOOT, ResponseCode.SESSION_NOT_OPEN)
    assert session.call(SHOOT, once=True).code == ResponseCode.OK  # it said that it did nothing
    assert camera.seen == [SHOOT.name, *BEGIN, SHOOT.name] and bench.restored == 2


def test_a_camera_that_never_remembers_its_session_is_given_up(
    bench: Bench, camera: Camera
) -> None:
    session = bench.session()
    camera.fails(PING, *[int(ResponseCode.SESSION_NOT_OPEN)] * 20)
    with pytest.raises(DeviceLost, match="forgot"):
        session.call(PING)


def test_unplugged_for_good(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    camera.fails(PING, DeviceGone())
    camera.on_bus = False
    began_ns = bench.clock.now_ns()
    with pytest.raises(DeviceLost, match="no camera"):
        session.call(PING)
    assert (bench.clock.now_ns() - began_ns) * 1e-9 < LONGEST_OPERATION_S
    assert not session.is_open


def test_unplugged_for_a_moment(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    camera.fails(PING, DeviceGone())
    camera.on_bus = False
    camera.comes_back_ns = bench.clock.now_ns() + 2_000_000_000
    assert session.call(PING).code == ResponseCode.OK
    assert bench.restored == 2


def test_a_session_left_over_by_another_program_is_replaced(bench: Bench, camera: Camera) -> None:
    camera.fails(Operation.OPEN_SESSION, ResponseCode.SESSION_ALREADY_OPEN)
    session = PtpSession(None, bench.clock, lambda: None)
    session.open()
    assert camera.seen == ["OPEN_SESSION", "CLOSE_SESSION", "OPEN_SESSION", "GET_DEVICE_INFO"]


def test_first_contact_is_tried_again_and_then_reset(bench: Bench, camera: Camera) -> None:
    camera.fails(Operation.OPEN_SESSION, *[WireTimeout("x")] * 3)
    PtpSession(None, bench.clock, lambda: None).open()
    assert camera.seen == [
        *("OPEN_SESSION", "cancel", "OPEN_SESSION", "cancel", "OPEN_SESSION"),
        *("reset", *BEGIN),
    ]


def test_no_camera(bench: Bench, camera: Camera) -> None:
    camera.on_bus = False
    with pytest.raises(DeviceLost, match="plug it in"):
        bench.session()


def test_of_two_cameras_the_serial_number_chooses(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = Camera("0001", address=5), Camera("0002", address=6)
    bench = Bench(monkeypatch, first, second)
    with pytest.raises(ConfigError, match=r"address 5.*address 6"):
        bench.session()
    session = bench.session(serial="0002")
    assert session.name == "camera 0002" and first.closed == 1
    with pytest.raises(DeviceLost, match="0001, 0002"):
        bench.session(serial="0003")


def test_a_port_that_was_reset_gives_back_the_same_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    first = Camera("0001", address=5)
    bench = Bench(monkeypatch, first)
    session = bench.session()
    bench.cameras.insert(0, Camera("0002", address=9))  # plugged in meanwhile
    first.fails(PING, *[WireTimeout("x")] * 3)
    assert session.call(PING).code == ResponseCode.OK
    assert session.name == "camera 0001"


def test_close_is_idempotent_and_never_raises(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    camera.fails(Operation.CLOSE_SESSION, DeviceGone())
    session.close()
    session.close()
    assert camera.closed == 1 and not session.is_open
