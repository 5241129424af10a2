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
from pdcd.bench.patience import Patience
from pdcd.errors import ConfigError, DeviceLost, ExposureError

INFO = DeviceInfo("Canon Inc.", "Canon EOS 450D", "3-1.0.4", "0001", (0x1001,))

PING = Operation.EOS_KEEP_DEVICE_ON

SHOOT = Operation.EOS_BULB_START

OPEN, CLOSE, WHO = Operation.OPEN_SESSION, Operation.CLOSE_SESSION, Operation.GET_DEVICE_INFO


@dataclass
class Camera:
    """One device on the bus: what happens to it, and what it was asked."""

    serial: str = "0001"
    on_bus: bool = True
    script: dict[object, deque[Any]] = field(default_factory=lambda: defaultdict(deque))
    seen: list[str] = field(default_factory=list)
    asked: list[tuple[Any, ...]] = field(default_factory=list)
    info: bytes | None = None
    closed: int = 0
    comes_back_ns: int | None = None
    idVendor: int = 0x04A9  # noqa: N815 - pyusb's names
    idProduct: int = 0x3145  # noqa: N815
    bus: int = 1
    address: int = 5

    def fails(self, what: object, *outcomes: Exception | int) -> None:
        self.script[what].extend(outcomes)

    def meet(self, what: object) -> int:
        self.seen.append(what.name if isinstance(what, Operation) else str(what))
        outcome = self.script[what].popleft() if self.script[what] else ResponseCode.OK
        if isinstance(outcome, Exception):
            raise outcome
        return int(outcome)


class Bench:
    """The session's module with a scripted bus below it."""

    def __init__(self, patch: pytest.MonkeyPatch, *cameras: Camera) -> None:
        self.clock = VirtualClock()
        self.cameras = list(cameras)
        self.restored = self.signs = self.looks = 0
        self.restores: deque[Exception | None] = deque()
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
                self.camera.asked.append((code, params, data, timeout_s))
                try:
                    answer = self.camera.meet(code)
                except WireTimeout:
                    bench.sleep(timeout_s)
                    raise
                info = DeviceInfo(**{**INFO.__dict__, "serial": self.camera.serial}).pack()
                found = (self.camera.info or info) if code == WHO else b""
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
                if self.camera.script["close"]:
                    self.camera.meet("close")

        def find(backend: Any, usb_id: Any) -> list[Camera]:
            self.looks += 1
            for camera in bench.cameras:
                back_ns = camera.comes_back_ns
                camera.on_bus |= back_ns is not None and bench.clock.now_ns() >= back_ns
            return [camera for camera in bench.cameras if camera.on_bus]

        patch.setattr(module, "Transport", Transport)
        patch.setattr(module, "UsbPort", lambda camera, look: camera)
        patch.setattr(module, "find_cameras", find)

    def sleep(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * 1e9))

    def restore(self) -> None:
        self.restored += 1
        if self.restores and (fault := self.restores.popleft()) is not None:
            raise fault

    def alive(self) -> None:
        self.signs += 1

    def closed_session(self, serial: str | None = None) -> PtpSession:
        return PtpSession(
            None, self.clock, self.restore, serial=serial, patience=Patience(self.clock, self.alive)
        )

    def session(self, serial: str | None = None) -> PtpSession:
        made = self.closed_session(serial)
        made.open()
        for camera in self.cameras:
            camera.seen.clear()
            camera.asked.clear()
        self.looks = self.signs = 0
        return made


@pytest.fixture
def camera() -> Camera:
    return Camera()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, camera: Camera) -> Bench:
    return Bench(monkeypatch, camera)


BEGIN = ["OPEN_SESSION", "GET_DEVICE_INFO"]


# First contact.


def test_first_contact_is_short_and_made_once(bench: Bench, camera: Camera) -> None:
    """A camera that is well answers at once."""
    session = bench.closed_session()
    assert not session.is_open and session.name == "" and session.info is None
    assert session.open() == session.open() == INFO
    assert camera.seen == BEGIN and {asked[3] for asked in camera.asked} == {1.5}
    assert session.is_open and session.name == "camera 0001"
    assert (session.renewed, session.found, session.climbs, bench.restored) == (1, 1, 0, 1)
    session.close()
    assert camera.asked[-1] == (CLOSE, (), None, 1.5) and camera.closed == 1
    assert not session.is_open and session.name == ""


def test_first_contact_is_tried_three_times_and_then_reset(bench: Bench, camera: Camera) -> None:
    camera.fails(OPEN, *[WireTimeout("x")] * 3)
    camera.fails("cancel", WireTimeout("y"))  # then the next try says why
    bench.closed_session().open()
    assert camera.seen == [
        *("OPEN_SESSION", "cancel", "OPEN_SESSION", "cancel", "OPEN_SESSION"),
        *("reset", *BEGIN),
    ]


def test_a_camera_that_is_gone_at_first_contact_is_sought_at_once(
    bench: Bench, camera: Camera
) -> None:
    camera.fails(OPEN, DeviceGone())
    session = bench.closed_session()
    session.open()
    assert camera.seen == ["OPEN_SESSION", "usb reset", *BEGIN]
    assert session.climbs == 1 and session.found == 1


@pytest.mark.parametrize(
    ("code", "more"),
    [
        (ResponseCode.OK, ["GET_DEVICE_INFO"]),
        (ResponseCode.SESSION_ALREADY_OPEN, ["GET_DEVICE_INFO"]),  # it will do
        (ResponseCode.GENERAL_ERROR, ["cancel", *BEGIN]),
    ],
)
def test_a_session_left_over_by_another_program_is_replaced(
    bench: Bench, camera: Camera, code: int, more: list[str]
) -> None:
    camera.fails(OPEN, ResponseCode.SESSION_ALREADY_OPEN, code)
    bench.closed_session().open()
    assert camera.seen == ["OPEN_SESSION", "CLOSE_SESSION", "OPEN_SESSION", *more]


def test_a_body_that_says_nonsense_of_itself_is_given_up(bench: Bench, camera: Camera) -> None:
    camera.info = b"\1"
    session = bench.closed_session()
    with pytest.raises(DeviceLost, match="cannot be brought back: DeviceInfo"):
        session.open()
    assert not session.is_open


@pytest.mark.parametrize(
    "fault", [ConfigError("two of them"), ExposureError("no card"), RuntimeError("a bug")]
)
def test_what_is_no_fault_of_the_wire_is_told_as_it_is(
    bench: Bench, camera: Camera, fault: Exception
) -> None:
    bench.restores.append(fault)
    session = bench.closed_session()
    with pytest.raises(type(fault), match=str(fault.args[0])):
        session.open()
    assert session.climbs == 0
    if not isinstance(fault, RuntimeError):
        assert camera.closed == 1 and not session.is_open
    session.close()
    session.open()
    camera.fails(PING, RuntimeError("a bug"))
    with pytest.raises(RuntimeError, match="a bug"):
        session.call(PING)


# The ladder.


def test_a_camera_that_is_well_is_asked_once(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    assert session.call(PING, 3, data=b"abc").code == ResponseCode.OK
    assert camera.asked == [(PING, (3,), b"abc", TRANSACTION_S)] and bench.restored == 1


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
    """Each rung is a sign of life, and all of them one climb."""
    session = bench.session()
    for what in (PING, "cancel", "reset"):
        camera.fails(what, WireTimeout("x"))
    assert session.call(PING).code == ResponseCode.OK
    assert camera.seen == [PING.name, "cancel", "reset", "usb reset", *BEGIN, PING.name]
    assert camera.address == 6
    assert (session.climbs, session.renewed, session.found) == (1, 2, 2)
    assert bench.signs == 4  # three rungs, and a look for the camera


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
    with pytest.raises(DeviceLost, match=r"is off line .*off and on"):
        session.call(PING)
    session.open()
    assert session.call(PING).code == ResponseCode.OK


def test_a_dead_camera_at_every_rung_gives_up_in_time(bench: Bench, camera: Camera) -> None:
    session = bench.session()
    for what in (PING, "cancel", OPEN):
        camera.fails(what, *[WireTimeout("x")] * 100)
    began_ns = bench.clock.now_ns()
    with pytest.raises(DeviceLost, match="off and on"):
        session.call(PING)
    assert (bench.clock.now_ns() - began_ns) * 1e-9 < LONGEST_OPERATION_S


def test_what_fails_while_a_rung_is_climbed_leads_to_the_next(bench: Bench, camera: Camera) -> None:
    """Modes are set by operations, and a fault of these does not climb by itself."""
    session = bench.session()
    camera.fails(PING, WireTimeout("x"))
    camera.fails("cancel", WireTimeout("x"))
    bench.restores.extend([ExposureError("no modes"), None])
    session.call(PING)
    assert camera.seen == [PING.name, "cancel", "reset", *BEGIN, "usb reset", *BEGIN, PING.name]
    assert session.climbs == 1


def test_an_operation_within_a_rung_does_not_climb(
    bench: Bench, camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = bench.session()
    told: list[int] = []
    monkeypatch.setattr(session, "_restore", lambda: told.append(session.call(PING).code))
    camera.fails(Operation.EOS_GET_EVENT, ResponseCode.SESSION_NOT_OPEN)
    camera.fails(PING, WireTimeout("within"), ResponseCode.SESSION_NOT_OPEN)
    session.call(Operation.EOS_GET_EVENT)
    assert told == [ResponseCode.SESSION_NOT_OPEN]  # an answer like any other there
    assert camera.seen == [
        "EOS_GET_EVENT", *BEGIN, PING.name, "reset", *BEGIN, PING.name, "EOS_GET_EVENT",
    ]  # fmt: skip


@pytest.mark.parametrize("cancelled", [True, False])
def test_what_must_happen_once_is_never_repeated(
    bench: Bench, camera: Camera, cancelled: bool
) -> None:
    session = bench.session()
    camera.fails(SHOOT, WireTimeout("x"))
    if not cancelled:
        camera.fails("cancel", TransactionMismatch("x"))
    with pytest.raises(NoAnswer, match="EOS_BULB_START was not answered"):
        session.call(SHOOT, once=True)
    assert camera.seen == [SHOOT.name, "cancel", *(() if cancelled else ("reset", *BEGIN))]
    assert session.call(SHOOT, once=True).code == ResponseCode.OK


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


@pytest.mark.parametrize(("after_s", "back"), [(2.0, True), (5.0, True), (5.001, False)])
def test_a_camera_may_take_five_seconds_to_come_back(
    bench: Bench, camera: Camera, after_s: float, back: bool
) -> None:
    session = bench.session()
    camera.fails(PING, DeviceGone())
    camera.on_bus = False
    began_ns = bench.clock.now_ns()
    camera.comes_back_ns = began_ns + round(after_s * 1e9)
    if back:
        assert session.call(PING).code == ResponseCode.OK
        assert bench.restored == 2
    else:
        with pytest.raises(DeviceLost, match="cannot be brought back: no camera"):
            session.call(PING)
        assert bench.clock.now_ns() - began_ns == 5_000_000_000
        assert bench.signs > bench.looks >= 26  # a sign of life with each look
    assert session.is_open == back


# Which camera, and the end.


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


@pytest.mark.parametrize("what", [CLOSE, "close"])
def test_a_close_never_raises_and_is_done_once(
    bench: Bench, camera: Camera, what: object, caplog: pytest.LogCaptureFixture
) -> None:
    session = bench.session()
    camera.fails(what, WireTimeout("x"))
    session.close()
    session.close()
    assert camera.closed == 1 and not session.is_open
    assert "camera 0001" in caplog.text


def test_a_camera_that_goes_again_and_again_is_said_to_be_gone(
    bench: Bench, camera: Camera
) -> None:
    session = bench.session()
    camera.fails(PING, DeviceGone())
    camera.fails(OPEN, *[DeviceGone() for _ in range(1000)])
    with pytest.raises(DeviceGone):
        session.call(PING)
