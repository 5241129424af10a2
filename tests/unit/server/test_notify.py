"""What the service manager hears, and what it is believed."""

from __future__ import annotations

import logging
import os
import socket
from pathlib import Path

import pytest

from pdcd.server.notify import Notifier, count_listen_fds, watchdog_s


@pytest.mark.parametrize(
    ("lines", "heard"),
    [
        (("READY=1", "STATUS=idle"), b"READY=1\nSTATUS=idle"),
        (("STATUS=x\nMAINPID=1\x1b",), b"STATUS=x\\nMAINPID=1\\u001b"),
    ],
)
@pytest.mark.parametrize("abstract", [False, True])
def test_lines_arrive_as_one_datagram_and_stay_one_line_each(
    tmp_path: Path, lines: tuple[str, ...], heard: bytes, abstract: bool
) -> None:
    """An abstract address begins with an at sign."""
    name = f"pdcd-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + name if abstract else name)
        Notifier({"NOTIFY_SOCKET": "@" * abstract + name}).send(*lines)
        assert manager.recv(4096) == heard


def test_a_manager_that_is_gone_is_only_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")}).send("READY=1")
    assert [record.levelno for record in caplog.records] == [logging.WARNING]


def test_a_manager_that_does_not_read_does_not_hold_us_up(tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        notifier = Notifier({"NOTIFY_SOCKET": address})
        for _ in range(2000):
            notifier.send("STATUS=" + "x" * 200)
        assert manager.recv(4096).startswith(b"STATUS=")


@pytest.mark.parametrize(
    ("environ", "expected_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "20000000"}, 20.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": str(os.getpid())}, 20.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
    ],
)
def test_the_watchdog_is_for_this_process_only(
    environ: dict[str, str], expected_s: float | None
) -> None:
    assert watchdog_s(environ) == expected_s


@pytest.mark.parametrize(
    ("environ", "expected"),
    [
        ({}, 0),
        ({"LISTEN_FDS": "1"}, 0),
        ({"LISTEN_FDS": "1", "LISTEN_PID": "1"}, 0),
        ({"LISTEN_FDS": "1", "LISTEN_PID": str(os.getpid())}, 1),
        ({"LISTEN_FDS": "x", "LISTEN_PID": str(os.getpid())}, 0),
    ],
)
def test_sockets_are_taken_only_when_meant_for_us(environ: dict[str, str], expected: int) -> None:
    assert count_listen_fds(environ) == expected
