"""The service manager's protocols at their edges."""

from __future__ import annotations

import os
import socket

import pytest

from pdcd.server.notify import FIRST_FD, Notifier, count_listen_fds, watchdog_s

ME = str(os.getpid())


def test_passed_sockets_begin_after_the_three_that_every_process_has() -> None:
    assert FIRST_FD == 3  # SD_LISTEN_FDS_START of sd_listen_fds(3)
    assert count_listen_fds({"LISTEN_FDS": "2", "LISTEN_PID": ME}) == 2
    assert count_listen_fds({"LISTEN_PID": ME}) == 0
    assert count_listen_fds({"LISTEN_FDS": "-1", "LISTEN_PID": ME}) == 0


def test_times_of_the_watchdog_are_microseconds() -> None:
    assert watchdog_s({"WATCHDOG_USEC": "1"}) == pytest.approx(1e-6)
    assert watchdog_s({"WATCHDOG_USEC": "2"}) == pytest.approx(2e-6)
    assert watchdog_s({"WATCHDOG_USEC": "1500000"}) == 1.5
    assert watchdog_s({"WATCHDOG_USEC": "-5"}) is None
    assert watchdog_s({"WATCHDOG_USEC": ""}) is None


def test_what_the_process_was_started_with_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("WATCHDOG_USEC", "3000000"), ("LISTEN_FDS", "4"), ("LISTEN_PID", ME)):
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    assert (watchdog_s(), count_listen_fds()) == (3.0, 4)


def test_a_manager_that_reads_slowly_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[socket.socket] = []
    blocking: list[bool] = []
    whole = socket.socket

    class Noted(whole):  # type: ignore[misc,valid-type]
        def __init__(self, *told: int) -> None:
            super().__init__(*told)
            made.append(self)

        def sendto(self, *told: object) -> int:
            blocking.append(self.getblocking())
            return 0

    monkeypatch.setattr(socket, "socket", Noted)
    Notifier({"NOTIFY_SOCKET": "/there"}).send("READY=1")
    assert blocking == [False] and made[0].fileno() == -1


def test_a_fault_of_ours_is_no_manager_that_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    def fault(*_: object) -> None:
        raise ZeroDivisionError

    notifier = Notifier({"NOTIFY_SOCKET": "/there"})
    monkeypatch.setattr(socket, "socket", fault)
    with pytest.raises(ZeroDivisionError):
        notifier.send("READY=1")
    Notifier({"NOTIFY_SOCKET": ""}).send("READY=1")  # there is nobody to tell
