"""The plug of a virtual DMD controller: reports that come and go, and what goes wrong with them.

Each controller defines what its commands do.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Sequence
from typing import ClassVar

from pdcd.driver import Clock

from .model import VirtualDmdFault
from .reports import ReportAssembler, TakenCommand


class ReportController(ABC):
    """A controller that takes commands in reports of 64 bytes. Safe for several threads.

    usb_ids, product : what it is on the USB. reports : that came and went. unplug_at : the report
    at which the plug is pulled. report_s : time that one report takes. hung_until_ns : until then
    none goes either way.
    """

    usb_ids: ClassVar[tuple[int, int]]
    product: ClassVar[str]

    def __init__(
        self,
        clock: Clock,
        serial: str,
        report_s: float,
        faults: Sequence[VirtualDmdFault] = (),
        replies_kept: int = 1,
    ) -> None:
        self.clock, self.serial, self.report_s = clock, serial, report_s
        self.faults = tuple(faults)
        self.reports = 0
        self.unplug_at: int | None = None
        self.plugged_again = 0
        self.hung_until_ns = 0
        self._lock = threading.RLock()
        self._assembler = ReportAssembler()
        self._replies: deque[bytes] = deque(maxlen=replies_kept)
        self._held: bytes | None = None
        self._calls: Counter[int] = Counter()
        self._out, self._gone_until_ns = False, 0

    @abstractmethod
    def restart(self) -> None:
        """Switch it off and on."""

    @abstractmethod
    def _answer(self, command: TakenCommand, fault: VirtualDmdFault | None) -> bytes:
        """Do a command, and return the outcome."""

    # The plug

    @property
    def plugged(self) -> bool:
        """Whether it is on the USB."""
        return not self._out and self.clock.now_ns() >= self._gone_until_ns

    def unplug(self) -> None:
        """Pull the plug of the USB."""
        with self._lock:
            self._out = True
            self._forget_reports()

    def replug(self) -> None:
        """Put it back."""
        self._out = False
        self.plugged_again += 1

    def _leave_until(self, at_ns: int) -> None:
        """Leave the USB until `at_ns`, and come back under another address."""
        self._gone_until_ns = at_ns
        self.plugged_again += 1

    # Reports

    def count_report(self) -> None:
        """Count one report, in either direction; at report `unplug_at` the plug is pulled."""
        self.reports += 1
        if self.unplug_at is not None and self.reports >= self.unplug_at:
            self.unplug_at = None
            self.unplug()

    def write_report(self, report: bytes) -> None:
        """Take a report; a command is done once it is complete."""
        with self._lock:
            command = self._assembler.add(report)
            if command is not None:
                self._take(command)

    def read_report(self) -> bytes | None:
        """The next reply, 64 bytes; None if there is none."""
        with self._lock:
            return self._replies.popleft() if self._replies else None

    def _forget_reports(self) -> None:
        self._assembler.forget()
        self._replies.clear()
        self._held = None

    def _take(self, command: TakenCommand) -> None:
        fault = self._meet(command.code)
        kind = None if fault is None else fault.kind
        if fault is not None and kind == "busy":
            self.hung_until_ns = self.clock.now_ns() + round(fault.seconds * 1e9)
        if kind == "unplug":
            return self.unplug()
        if kind == "reset":
            return self.restart()
        if kind == "deaf":
            return
        reply = self._answer(command, fault)
        if not command.wants_reply or kind == "mute" or not self.plugged:
            return
        held, self._held = self._held, None
        if kind == "late":
            self._held = reply
            return
        self._replies.append(reply)
        if held is not None:
            self._replies.append(held)

    def _meet(self, code: int) -> VirtualDmdFault | None:
        self._calls[code] += 1
        call = self._calls[code]
        for fault in self.faults:
            if fault.command == code and fault.first <= call < fault.first + fault.times:
                return fault
        return None
