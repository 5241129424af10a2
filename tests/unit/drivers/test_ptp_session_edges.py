"""The session's waits and counts, and which faults are let through as they are."""

from __future__ import annotations

from collections import defaultdict, deque
from typing import Any

import pytest

from drivers.ptp import session as module
from drivers.ptp.codes import Operation, ResponseCode
from drivers.ptp.datasets import DeviceInfo
from drivers.ptp.faults import POWER_CYCLE, DeviceGone, NoAnswer, TransactionMismatch, WireTimeout
from drivers.ptp.session import PtpSession
from drivers.ptp.transport import TransactionReply
from pdcd.bench.clock import VirtualClock
from pdcd.errors import ConfigError, DeviceLost, ExposureError

INFO = DeviceInfo("Canon Inc.", "Canon EOS 450D", "3-1.0.4", "0001", (0x1001,))
OPEN, CLOSE, WHO = Operation.OPEN_SESSION, Operation.CLOSE_SESSION, Operation.GET_DEVICE_INFO
PING = Operation.EOS_KEEP_DEVICE_ON


class Bench:
    """A session on a scripted transport: what is not scripted goes well."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.clock = VirtualClock()
        self.script: dict[object, deque[Any]] = defaultdict(deque)
        self.asked: list[Any] = []
        self.found: list[Any] = []
        self.data: bytes = INFO.pack()
        self.restores: deque[Exception | None] = deque()
        self.restored = self.signs = 0
        self.backend: list[Any] = []
        bench = self

        class Transport:
            name = "the camera"

            def __init__(self, port: Any, clock: Any) -> None: ...

            def restart_ids(self) -> None:
                bench.asked.append("restart")

            def transact(
                self, code: Operation, params: Any = (), data: Any = None, timeout_s: float = 8.0
            ) -> TransactionReply:
                bench.asked.append((code.name, params, timeout_s))
                answer = bench.meet(code)
                return TransactionReply(answer or ResponseCode.OK, (), memoryview(bench.data))

            def back_in_step(self) -> None:
                bench.note("cancel")

            def device_reset(self) -> None:
                bench.note("reset")

            def usb_reset(self) -> None:
                bench.note("usb reset")

            def close(self) -> None:
                bench.note("close")

        def find(backend: Any, usb_id: Any) -> list[Any]:
            bench.backend.append((backend, usb_id))
            bench.meet("find")
            return ["a camera"]

        self.transport = Transport
        patch.setattr(module, "Transport", Transport)
        patch.setattr(module, "UsbPort", lambda device: device)
        patch.setattr(module, "find_cameras", find)
        patch.setattr(module, "describe_device", str)
        self.session = PtpSession(
            "backend", self.clock, self._restore, usb_id=(1, 2), alive=self._alive
        )

    def _restore(self) -> None:
        self.restored += 1
        if self.restores and (fault := self.restores.popleft()) is not None:
            raise fault

    def _alive(self) -> None:
        self.signs += 1

    def meet(self, what: object) -> Any:
        outcome = self.script[what].popleft() if self.script[what] else None
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    def note(self, what: str) -> None:
        self.asked.append(what)
        self.meet(what)

    def fails(self, what: object, *outcomes: Any) -> None:
        self.script[what].extend(outcomes)

    def names(self) -> list[str]:
        """What was asked, by name, since it was asked for last."""
        names = [one if isinstance(one, str) else one[0] for one in self.asked]
        self.asked.clear()
        return names


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


@pytest.fixture
def opened(bench: Bench) -> Bench:
    bench.session.open()
    bench.asked.clear()
    return bench


HELLO = ["restart", "OPEN_SESSION", "GET_DEVICE_INFO"]


def test_first_contact_is_short(bench: Bench) -> None:
    """A camera that is well answers at once."""
    session = bench.session
    assert not session.is_open and session.name == "" and session.info is None
    assert session.open() == INFO
    assert bench.asked == [
        "restart", ("OPEN_SESSION", (1,), 1.5), ("GET_DEVICE_INFO", (), 1.5),
    ]  # fmt: skip
    assert session.is_open and session.name == "the camera"
    assert (session.renewed, session.found, session.climbs, bench.restored) == (1, 1, 0, 1)
    assert bench.backend == [("backend", (1, 2))]
    bench.asked.clear()
    assert session.open() == INFO and bench.asked == []
    session.close()
    assert bench.asked == [("CLOSE_SESSION", (), 1.5), "close"]
    assert not session.is_open and session.name == ""


def test_first_contact_is_tried_three_times(bench: Bench) -> None:
    bench.fails(WHO, WireTimeout("x"), WireTimeout("x"))
    bench.fails("cancel", WireTimeout("y"))  # then the next try says why
    bench.session.open()
    assert bench.names() == [*HELLO, "cancel", *HELLO, "cancel", *HELLO]
    assert bench.session.climbs == 0 and bench.signs == 0


def test_a_camera_that_is_gone_at_first_contact_is_sought_at_once(bench: Bench) -> None:
    bench.fails(OPEN, DeviceGone())
    bench.session.open()
    assert bench.names() == ["restart", "OPEN_SESSION", "usb reset", *HELLO]
    assert bench.session.climbs == 1 and bench.session.found == 1


@pytest.mark.parametrize(
    ("code", "begins"),
    [(ResponseCode.SESSION_ALREADY_OPEN, True), (ResponseCode.GENERAL_ERROR, False)],
)
def test_a_session_that_is_still_there_after_it_was_closed_will_do(
    bench: Bench, code: ResponseCode, begins: bool
) -> None:
    bench.fails(OPEN, ResponseCode.SESSION_ALREADY_OPEN, code)
    bench.session.open()
    names = bench.names()
    first = ["restart", "OPEN_SESSION", "CLOSE_SESSION", "restart", "OPEN_SESSION"]
    assert names == ([*first, "GET_DEVICE_INFO"] if begins else [*first, "cancel", *HELLO])


def test_a_body_that_does_not_say_what_it_is_is_asked_again(bench: Bench) -> None:
    bench.fails(WHO, ResponseCode.GENERAL_ERROR)
    bench.session.open()
    assert bench.names() == [*HELLO, "cancel", *HELLO]


def test_a_body_that_says_nonsense_of_itself_is_given_up(bench: Bench) -> None:
    bench.data = b"\1"
    with pytest.raises(DeviceLost, match="cannot be brought back: DeviceInfo"):
        bench.session.open()
    assert not bench.session.is_open


@pytest.mark.parametrize("fault", [ConfigError("two of them"), ExposureError("no card")])
def test_what_is_no_fault_of_the_wire_is_told_as_it_is(bench: Bench, fault: Exception) -> None:
    bench.restores.append(fault)
    with pytest.raises(type(fault), match=str(fault.args[0])):
        bench.session.open()
    assert bench.asked[-1] == "close" and not bench.session.is_open
    assert bench.session.climbs == 0
    bench.session.open()


def test_a_bug_is_a_bug(bench: Bench) -> None:
    bench.restores.append(RuntimeError("a bug"))
    with pytest.raises(RuntimeError, match="a bug"):
        bench.session.open()
    bench.session.close()
    bench.session.open()
    bench.fails(PING, RuntimeError("a bug"))
    with pytest.raises(RuntimeError, match="a bug"):
        bench.session.call(PING)


# The ladder.


def test_each_rung_is_a_sign_of_life_and_counted_once_a_climb(opened: Bench) -> None:
    opened.fails(PING, WireTimeout("x"))
    for what in ("cancel", "reset"):
        opened.fails(what, WireTimeout(what))
    opened.session.call(PING)
    assert opened.names() == [PING.name, "cancel", "reset", "usb reset", *HELLO, PING.name]
    assert opened.session.climbs == 1
    assert opened.signs == 4  # three rungs, and a look for the camera
    assert (opened.session.renewed, opened.session.found) == (2, 2)


def test_a_camera_may_take_five_seconds_to_come_back(opened: Bench) -> None:
    opened.fails(PING, DeviceGone())
    opened.fails("find", *[DeviceLost("not there")] * 1000)
    before_ns = opened.clock.now_ns()
    with pytest.raises(DeviceLost, match="cannot be brought back: not there"):
        opened.session.call(PING)
    assert opened.clock.now_ns() - before_ns == 5_000_000_000
    assert len(opened.backend) == 1 + 26  # every fifth of a second, at the end as well
    assert opened.signs == 27


@pytest.mark.parametrize(("looks", "comes_back"), [(25, True), (26, False)])
def test_one_that_is_there_at_the_last_look_has_come_back(
    opened: Bench, looks: int, comes_back: bool
) -> None:
    opened.fails(PING, DeviceGone())
    opened.fails("find", *[DeviceLost("not there")] * looks)
    if comes_back:
        assert opened.session.call(PING).code == ResponseCode.OK
    else:
        with pytest.raises(DeviceLost):
            opened.session.call(PING)
    assert opened.session.is_open == comes_back


def test_one_that_stays_away_is_said_to_be_gone(opened: Bench) -> None:
    opened.fails(PING, DeviceGone())
    opened.fails("find", *[DeviceGone() for _ in range(100)])
    with pytest.raises(DeviceGone):
        opened.session.call(PING)
    with pytest.raises(DeviceLost, match="is off line") as caught:
        opened.session.call(PING)
    assert caught.value.hint == POWER_CYCLE and caught.value.device == "camera"


def test_what_fails_while_a_rung_is_climbed_leads_to_the_next(opened: Bench) -> None:
    """Modes are set by operations, and a fault of these does not climb by itself."""
    opened.fails(PING, WireTimeout("x"))
    opened.fails("cancel", WireTimeout("x"))
    opened.restores.extend([ExposureError("no modes"), None])
    opened.session.call(PING)
    assert opened.names() == [PING.name, "cancel", "reset", *HELLO, "usb reset", *HELLO, PING.name]
    assert opened.session.climbs == 1


def test_an_operation_within_a_rung_does_not_climb(
    opened: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Any] = []

    def restore() -> None:
        calls.append(opened.session.call(PING).code)

    monkeypatch.setattr(opened.session, "_restore", restore)
    opened.fails(Operation.EOS_GET_EVENT, ResponseCode.SESSION_NOT_OPEN)
    opened.fails(PING, WireTimeout("within"), ResponseCode.SESSION_NOT_OPEN)
    opened.session.call(Operation.EOS_GET_EVENT)
    assert calls == [ResponseCode.SESSION_NOT_OPEN]  # an answer like any other there
    assert opened.names() == [
        "EOS_GET_EVENT", *HELLO, PING.name, "reset", *HELLO, PING.name, "EOS_GET_EVENT",
    ]  # fmt: skip


def test_what_must_happen_once_is_told_as_unanswered_whatever_rung_helped(opened: Bench) -> None:
    opened.fails(PING, TransactionMismatch("x"))
    opened.fails("cancel", TransactionMismatch("x"))
    with pytest.raises(NoAnswer, match="EOS_KEEP_DEVICE_ON was not answered"):
        opened.session.call(PING, once=True)
    assert opened.names() == [PING.name, "cancel", "reset", *HELLO]
    assert opened.session.call(PING, once=True).code == ResponseCode.OK


def test_operations_carry_their_parameters_and_data(
    opened: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened.session.call(PING, 3, 4)
    assert opened.asked == [(PING.name, (3, 4), 8.0)]
    given: list[Any] = []

    def transact(_: Any, *what: Any) -> TransactionReply:
        given.append(what)
        return TransactionReply(0x2001, (), memoryview(b""))

    monkeypatch.setattr(opened.transport, "transact", transact)
    opened.session.call(PING, 5, data=b"abc")
    assert given == [(PING, (5,), b"abc")]


@pytest.mark.parametrize("what", [CLOSE, "close"])
def test_a_close_never_raises_and_is_done_once(
    opened: Bench, what: object, caplog: pytest.LogCaptureFixture
) -> None:
    opened.fails(what, WireTimeout("x"))
    opened.session.close()
    opened.session.close()
    assert opened.names() == ["CLOSE_SESSION", "close"]
    assert "the camera" in caplog.text
