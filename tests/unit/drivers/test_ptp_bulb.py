"""The state of a held-open shutter, on scripted answers: when is it open, and who is told what."""

from __future__ import annotations

from collections import deque
from contextlib import suppress

import pytest

from drivers.ptp.bulb import BULB, REMOTE, Bulb, choose_method
from drivers.ptp.codes import Operation, ResponseCode
from drivers.ptp.datasets import DeviceInfo
from drivers.ptp.faults import NoAnswer
from drivers.ptp.options import ReleaseName
from drivers.ptp.transport import TransactionReply
from pdcd.bench.clock import VirtualClock
from pdcd.errors import ConfigError, DeviceLost, ExposureError

START, STOP = Operation.EOS_BULB_START, Operation.EOS_BULB_END


class Wire:
    """Answers from a script, OK where it ends, and notes what was sent."""

    def __init__(self, *answers: int | DeviceLost) -> None:
        self.answers = deque(answers)
        self.sent: list[tuple[Operation, tuple[int, ...], bool]] = []
        self.climbs = 0

    def __call__(self, code: Operation, *params: int, once: bool = False) -> TransactionReply:
        self.sent.append((code, params, once))
        answer = self.answers.popleft() if self.answers else ResponseCode.OK
        if isinstance(answer, DeviceLost):
            raise answer
        return TransactionReply(answer, (), memoryview(b""))

    @property
    def codes(self) -> list[Operation]:
        return [code for code, _, _ in self.sent]


def bulb(wire: Wire, clock: VirtualClock | None = None) -> Bulb:
    made = Bulb(wire, lambda: wire.climbs, clock or VirtualClock())
    made.method = BULB
    return made


@pytest.mark.parametrize(
    ("listed", "wanted", "found"),
    [
        ((0x9125, 0x9126), "auto", BULB),  # 40D, 450D, 1000D
        ((0x9125, 0x9126, 0x9128, 0x9129), "auto", REMOTE),  # 50D, 5D Mark II
        ((0x9128, 0x9129), "auto", REMOTE),  # newer
        ((0x1001,), "auto", None),  # 400D and older
        ((0x9125, 0x9126, 0x9128, 0x9129), "bulb", BULB),
        ((0x9125, 0x9126), "remote", REMOTE),
        ((0x9125, 0x9126), "external", None),
    ],
)
def test_the_method_is_chosen_by_what_the_body_lists(
    listed: tuple[int, ...], wanted: ReleaseName, found: object
) -> None:
    info = DeviceInfo("", "", "", "", listed)
    assert choose_method(info, wanted) is found


def test_both_methods_send_what_is_documented() -> None:
    wire = Wire()
    for method in (BULB, REMOTE):
        shutter = bulb(wire)
        shutter.method = method
        shutter.begin()
        assert shutter.since_ns is not None
        shutter.end()
        assert shutter.since_ns is None
    assert wire.sent == [
        (0x9125, (), True),
        (0x9126, (), False),
        (0x9128, (3, 1), True),
        (0x9129, (3,), False),
    ]


def test_a_body_without_a_way_says_that_it_needs_a_trigger() -> None:
    shutter = bulb(Wire())
    shutter.method = None
    with pytest.raises(ConfigError, match="external trigger"):
        shutter.begin()


def test_a_refused_start_is_closed_and_says_what_to_look_at() -> None:
    wire = Wire(ResponseCode.GENERAL_ERROR)
    shutter = bulb(wire)
    with pytest.raises(ExposureError, match="dial to M"):
        shutter.begin()
    assert shutter.since_ns is None and wire.codes == [START]


def test_an_end_that_fails_leaves_it_open_to_be_ended_again() -> None:
    wire = Wire(ResponseCode.OK, DeviceLost("x"))
    shutter = bulb(wire)
    shutter.begin()
    with pytest.raises(DeviceLost):
        shutter.end()
    assert shutter.since_ns is not None
    shutter.end()
    assert shutter.since_ns is None
    shutter.end()
    assert wire.codes == [START, STOP, STOP]  # one that is closed is left alone


def test_an_open_shutter_is_not_opened_again() -> None:
    wire = Wire()
    shutter = bulb(wire)
    shutter.begin()
    with pytest.raises(ExposureError, match="close it first"):
        shutter.begin()
    assert wire.codes == [START]


def test_a_photo_is_owed_by_whatever_may_have_opened() -> None:
    for answer, owed in (
        (ResponseCode.OK, True),
        (ResponseCode.GENERAL_ERROR, False),
        (NoAnswer("x"), True),
        (DeviceLost("x"), True),
    ):
        shutter = bulb(Wire(answer))
        assert not shutter.owed
        with suppress(ExposureError, DeviceLost):
            shutter.begin()
        assert shutter.owed == owed
        assert (shutter.since_ns is not None) == (
            owed and not isinstance(answer, NoAnswer)
        )  # one that was lost may have opened


def test_after_a_repeated_end_the_second_refusal_is_the_first_ones_success() -> None:
    wire = Wire()
    shutter = bulb(wire)
    shutter.begin()

    def climbing(code: Operation, *params: int, once: bool = False) -> TransactionReply:
        wire.climbs += 1
        return TransactionReply(ResponseCode.GENERAL_ERROR, (), memoryview(b""))

    shutter._order = climbing
    shutter.end()
    assert shutter.since_ns is None


@pytest.mark.parametrize(
    ("answer", "was_open", "refused"),
    [
        (ResponseCode.OK, True, False),
        (ResponseCode.GENERAL_ERROR, True, False),  # it held nothing open any more
        (ResponseCode.OPERATION_NOT_SUPPORTED, True, False),  # nor could it
        (ResponseCode.DEVICE_BUSY, True, True),
        (ResponseCode.INVALID_PARAMETER, True, True),
        (ResponseCode.DEVICE_BUSY, False, True),  # it may be open by somebody else's doing
        (ResponseCode.INVALID_PARAMETER, False, False),
    ],
)
def test_a_shutter_is_closed_by_a_new_session_only_where_the_camera_does_it(
    answer: int, was_open: bool, refused: bool
) -> None:
    wire = Wire(*[int(ResponseCode.OK)] * was_open, answer)
    shutter = bulb(wire)
    if was_open:
        shutter.begin()
    if refused:
        with pytest.raises(ExposureError, match="refuses to close the shutter"):
            shutter.new_session(BULB)
    else:
        shutter.new_session(BULB)
    assert (shutter.since_ns is not None) == (was_open and refused)
    assert wire.codes[-1] == STOP


def test_a_shutter_is_overdue_once_it_is_open_for_longer_than_allowed() -> None:
    clock = VirtualClock()
    shutter = bulb(Wire(), clock)
    clock.sleep_until_ns(clock.now_ns() + 10**12)
    assert not shutter.overdue(1000)  # closed, whatever the time
    shutter.begin()
    begun_ns = clock.now_ns()
    for open_ns, late in ((0, False), (999, False), (1000, False), (1001, True), (5000, True)):
        clock.sleep_until_ns(begun_ns + open_ns)
        assert shutter.overdue(1000) == late, open_ns
    shutter.end()
    assert not shutter.overdue(1000)


@pytest.mark.parametrize("refusals", [0, 1, 2, 3])
def test_a_camera_is_asked_three_times_to_close(refusals: int) -> None:
    wire = Wire(ResponseCode.OK, *[int(ResponseCode.GENERAL_ERROR)] * refusals)
    shutter = bulb(wire)
    shutter.begin()
    if refusals == 3:
        with pytest.raises(ExposureError, match="refuses to close the shutter: 0x2002"):
            shutter.end()
    else:
        shutter.end()
    assert wire.codes == [START, *[STOP] * min(refusals + 1, 3)]
    assert (shutter.since_ns is None) == (refusals < 3)


@pytest.mark.parametrize(
    ("answer", "open_still", "owed"),
    [
        (ResponseCode.OK, False, True),
        (ResponseCode.GENERAL_ERROR, False, False),  # it held nothing open
        (ResponseCode.DEVICE_BUSY, True, True),  # it has not done it
        (DeviceLost("x"), True, True),
    ],
)
def test_what_an_unanswered_start_leaves_depends_on_the_answer_to_its_end(
    answer: int | DeviceLost, open_still: bool, owed: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """It is never sent twice; the error is that of the start, whatever became of the end."""
    wire = Wire(NoAnswer("x"), answer)
    shutter = bulb(wire)
    with pytest.raises(ExposureError, match="did not confirm"):
        shutter.begin()
    assert wire.codes == [START, STOP]
    assert (shutter.since_ns is not None, shutter.owed) == (open_still, owed)
    assert ("may be open" in caplog.text) == open_still


def test_a_start_that_went_wrong_on_a_new_session_spoils_nothing_later() -> None:
    """The camera came back while the start was on its way: that exposure is over, and was told."""
    wire = Wire()
    shutter = bulb(wire)

    def climbing(code: Operation, *params: int, once: bool = False) -> TransactionReply:
        if once:
            shutter.new_session(BULB)
            raise NoAnswer("x")
        return wire(code, *params)

    shutter._order = climbing
    with pytest.raises(ExposureError, match="did not confirm"):
        shutter.begin()
    shutter.end()


def test_what_spoiled_one_exposure_is_not_said_of_the_next() -> None:
    for code in (ResponseCode.GENERAL_ERROR, ResponseCode.OK):
        wire = Wire(ResponseCode.OK, ResponseCode.OK, code)
        shutter = bulb(wire)
        shutter.begin()
        shutter.new_session(BULB)
        with suppress(ExposureError):
            shutter.begin()
        shutter.end()
        assert shutter.since_ns is None


def test_a_session_that_is_renewed_while_the_shutter_is_closed_has_closed_it() -> None:
    wire = Wire()
    shutter = bulb(wire)
    shutter.begin()

    def renewing(code: Operation, *params: int, once: bool = False) -> TransactionReply:
        shutter._order = wire
        shutter.new_session(REMOTE)
        return TransactionReply(ResponseCode.DEVICE_BUSY, (), memoryview(b""))

    shutter._order = renewing
    with pytest.raises(ExposureError, match="connection was lost while the shutter was open"):
        shutter.end()
    assert wire.codes == [START, REMOTE.stop] and shutter.since_ns is None


@pytest.mark.parametrize("is_open", [True, False])
def test_settling_closes_an_open_shutter_and_forgets_what_spoiled_the_last(is_open: bool) -> None:
    wire = Wire()
    shutter = bulb(wire)
    if is_open:
        shutter.begin()
    shutter.spoil("it lasted too long")
    shutter.settle()
    assert wire.codes == [START, STOP] * is_open and shutter.since_ns is None
    shutter.end()
