"""The link to a DLPC900: reports, answers, and every way in which a device fails to give one."""

from __future__ import annotations

import errno
from typing import Any

import pytest
import usb.core

from drivers.dlpc900.commands import Command
from drivers.dlpc900.link import DeviceLink, choose_device, list_devices
from pdcd.bench.clock import VirtualClock
from pdcd.errors import ConfigError, DeviceLost, DriverUnavailable, PdcdError
from tests.dlpc900_rig import NO_DEVICE, ScriptedDmd, ScriptedUsb


class Bench:
    """One device and a link to it; `reports` are all that it was sent."""

    def __init__(self, **script: Any) -> None:
        self.clock = VirtualClock()
        self.dmd = ScriptedDmd(self.clock, "A", (2, 1), **script)
        self.usb = ScriptedUsb(self.dmd)
        self.reports: list[bytes] = []
        self.looks = 0
        taken = self.dmd.take

        def take(report: bytes) -> None:
            self.reports.append(report)
            taken(report)

        self.dmd.take = take  # type: ignore[method-assign]

    def look(self) -> None:
        self.looks += 1

    def open(self) -> DeviceLink:
        return DeviceLink(list_devices(self.usb)[0], "mask", self.look)


def test_a_read_is_one_report_and_its_answer() -> None:
    bench = Bench(answers={0x1A0A: b"\x11"})
    link = bench.open()
    assert link.ask(Command.HARDWARE) == b"\x11"
    assert bench.reports == [bytes.fromhex("c0010200" + "0a1a").ljust(64, b"\0")]
    link.tell(Command.RUN, b"\x02")
    assert bench.reports[1] == bytes.fromhex("40020300" + "241a" + "02").ljust(64, b"\0")


def test_sequence_numbers_go_around_without_0() -> None:
    bench = Bench()
    link = bench.open()
    for _ in range(256):
        link.ask(Command.MAIN)
    assert [r[1] for r in bench.reports] == [*range(1, 256), 1]


def test_long_commands_go_on_in_reports_of_data_alone_and_want_no_answer() -> None:
    bench = Bench()
    link = bench.open()
    data = bytes(n % 251 for n in range(506))
    bench.dmd.sent.clear()
    link.tell(Command.PICTURE_BEGIN, bytes(6))
    link.pour(Command.PICTURE_DATA, b"\xf8\x01" + data[:504])
    assert [len(r) for r in bench.reports] == 9 * [64]
    first = bytes.fromhex("0002fc01" + "2b1a" + "f801")
    assert b"".join(bench.reports[1:]) == first + data[:504]
    with pytest.raises(usb.core.USBTimeoutError):
        bench.dmd.give()


def test_answers_to_other_commands_are_passed_over() -> None:
    bench = Bench(stale=3, answers={0x1A0C: b"\x08"})
    link = bench.open()
    assert link.ask(Command.MAIN) == b"\x08"
    bench.dmd.stale = 200
    with pytest.raises(DeviceLost, match="other answers than that to 0x1a0c") as caught:
        link.ask(Command.MAIN)
    assert caught.value.device == "mask" and caught.value.hint


def test_what_waited_from_before_is_dropped() -> None:
    bench = Bench()
    bench.dmd._replies.extend([bytes([0x40, 1, 1, 0, 7]).ljust(64, b"\0")] * 5)
    assert bench.open().ask(Command.LEAST_EXPOSURE)[:1] == b"\x69"


def test_a_refusal_is_explained_by_code_and_text() -> None:
    bench = Bench(refuses={0x1A34: 14})
    link = bench.open()
    with pytest.raises(ConfigError, match=r"exposure .code 14 after 0x1a34: pattern out of range"):
        link.tell(Command.ENTRY, bytes(12))
    assert [s.command for s in bench.dmd.sent] == [0x1A34, 0x0100, 0x0101]
    assert link.try_ask(Command.MODE) == b"\0"
    bench.dmd.refuses = {0x0205: 6}
    assert link.try_ask(Command.VERSION) is None
    bench.dmd.refuses = {0x0205: 6, 0x0100: 0, 0x0101: 0}
    with pytest.raises(DeviceLost, match=r"refused a command .no code after 0x0205. "):
        link.ask(Command.VERSION)


def test_errors_of_what_was_not_answered_are_asked_for() -> None:
    bench = Bench()
    link = bench.open()
    link.check_errors(Command.PICTURE_DATA)
    bench.dmd.answers[0x0100] = b"\x11"
    with pytest.raises(ConfigError, match=r"memory .code 17 after 0x1a2b"):
        link.check_errors(Command.PICTURE_DATA)


def test_a_silent_device_is_given_up_after_a_second() -> None:
    bench = Bench(silent=True)
    link = bench.open()
    begun_ns = bench.clock.now_ns()
    with pytest.raises(DeviceLost, match=r"A on port 1-2.1 does not answer") as caught:
        link.ask(Command.MAIN)
    assert 0.9 < 1e-9 * (bench.clock.now_ns() - begun_ns) < 1.2
    assert caught.value.device == "mask" and bench.looks >= 5 and link.lost


def test_what_not_every_firmware_knows_may_be_passed_over() -> None:
    bench = Bench(silent=True)
    link = bench.open()
    assert link.try_ask(Command.KIND) is None and not link.lost
    bench.dmd.silent = False
    bench.dmd.answers[0x0206] = b""
    assert link.try_ask(Command.KIND) is None
    assert link.ask(Command.LEAST_EXPOSURE)[:1] == b"\x69"


def test_who_looks_may_end_a_wait_but_no_command() -> None:
    """A device would take the next command for the rest of the one that was broken off."""
    bench = Bench(silent=True)
    link = bench.open()

    def stop() -> None:
        bench.looks += 1
        if bench.looks > 2:
            raise PdcdError("enough")

    link._look = stop
    link.pour(Command.PICTURE_DATA, bytes(506))
    with pytest.raises(PdcdError, match="enough"):
        link.ask(Command.MAIN)
    assert len(bench.reports) == 9 and not bench.dmd._packet


@pytest.mark.parametrize("report", [0, 3, 8])
def test_unplugged_at_any_report(report: int) -> None:
    def unplug(number: int) -> None:
        if number == report:
            raise NO_DEVICE

    bench = Bench(on_report=unplug)
    link = bench.open()
    with pytest.raises(DeviceLost, match="unplugged or switched off"):
        link.pour(Command.PICTURE_DATA, bytes(506))
        link.ask(Command.MAIN)
    link.close()


@pytest.mark.parametrize(
    ("number", "word", "hint"),
    [
        (errno.EBUSY, "held by another program", "end it"),
        (errno.EACCES, "may not be opened", "udev rule"),
        (errno.ENODEV, "unplugged", "cable"),
        (errno.EIO, "cannot be reached", "cable"),
    ],
)
def test_a_device_that_cannot_be_had(number: int, word: str, hint: str) -> None:
    bench = Bench(open_error=usb.core.USBError("libusb says no", -3, number))
    with pytest.raises(DeviceLost, match=word) as caught:
        bench.open()
    assert hint in str(caught.value.hint) and caught.value.device == "mask"


def test_the_kernel_gives_it_up_and_gets_it_back() -> None:
    bench = Bench()
    link = bench.open()
    assert not bench.dmd.kernel and bench.usb.claimed == {"A"}
    link.close()
    link.close()
    assert bench.dmd.kernel and not bench.usb.claimed


def test_devices_are_chosen_by_serial_number_or_port() -> None:
    clock = VirtualClock()
    found = list_devices(ScriptedUsb(*(ScriptedDmd(clock, s, (4, n)) for n, s in enumerate("ABB"))))
    assert [one.name for one in found] == [
        "A on port 1-4.0", "B on port 1-4.1", "B on port 1-4.2",
    ]  # fmt: skip
    assert choose_device(found, "A", "mask") is found[0]
    assert choose_device(found, "1-4.2", "mask") is found[2]
    with pytest.raises(DeviceLost, match="several devices are 'B'") as caught:
        choose_device(found, "B", "mask")
    assert caught.value.hint == "name the port: display.options.mask = '1-4.1'"
    with pytest.raises(DeviceLost, match=r"no DLPC900 is 'C'; found: A on port 1-4.0, B"):
        choose_device(found, "C", "mask")
    with pytest.raises(DeviceLost, match="found: none"):
        choose_device([], "C", "mask")


def test_serial_numbers_that_may_not_be_read_are_a_matter_of_rights() -> None:
    denied = usb.core.USBError("access denied", -3, errno.EACCES)
    usb_ = ScriptedUsb(ScriptedDmd(VirtualClock(), "A", (1,), open_error=denied))
    found = list_devices(usb_)
    assert found[0].serial is None and found[0].port == "1-1"
    with pytest.raises(DeviceLost, match="no DLPC900 is 'A'") as caught:
        choose_device(found, "A", "mask")
    assert "udev rule" in str(caught.value.hint)


def test_without_libusb(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: Any) -> Any:
        raise usb.core.NoBackendError("no backend")

    monkeypatch.setattr(usb.core, "find", refuse)
    with pytest.raises(DriverUnavailable, match="libusb"):
        list_devices(None)
