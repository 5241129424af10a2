"""What both processes share: memory, and a connection to the X server."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from Xlib import error

from pdcd.errors import ConfigError
from pdcd.presenter import xconnection
from pdcd.presenter.messages import copy_to_shared_memory, map_shared_arrays
from pdcd.presenter.xconnection import (
    ServerLost,
    close_x_connection,
    guard_x_calls,
    open_x_connection,
)

# Shared memory.


def test_shared_arrays_are_one_for_all_who_hold_the_descriptor() -> None:
    arrays: dict[str, Any] = {
        "head": np.arange(5, dtype=np.int64), "rows": np.arange(6, dtype=np.int32).reshape(2, 3),
        "none": np.zeros((0, 4), dtype=np.float32),
    }  # fmt: skip
    fd, slots, mine = copy_to_shared_memory(arrays)
    theirs = map_shared_arrays(fd, slots)
    assert not os.get_inheritable(fd) and os.fstat(fd).st_size == 128
    os.close(fd)
    for name, array in arrays.items():
        np.testing.assert_array_equal(theirs[name], array)
        assert theirs[name].dtype == array.dtype and theirs[name].shape == array.shape
    mine["rows"][1, 2] = 77
    theirs["head"][0] = 88
    assert theirs["rows"][1, 2] == 77 and mine["head"][0] == 88 and arrays["head"][0] == 0


# A connection to the X server.


class Knock:
    """A socket that notes where it was connected to; `fault` is raised there."""

    to: list[Any]
    fault: OSError | None = None

    def __init__(self, family: int) -> None:
        assert family == socket.AF_UNIX

    def __enter__(self) -> Knock:
        return self

    def __exit__(self, *unused: object) -> None:
        self.to.append("closed")

    def connect(self, address: str) -> None:
        self.to.append(address)
        if self.fault is not None:
            raise self.fault


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What was opened and where it was knocked; no path of a server is there."""
    found: list[Any] = []
    Knock.to, Knock.fault = found, None

    def display(name: str) -> str:
        print("strange cookies")  # noqa: T201 - as the library does
        found.append(("display", name))
        return f"a display of {name}"

    monkeypatch.setattr(xconnection, "Display", display)
    monkeypatch.setattr(socket, "socket", Knock)
    monkeypatch.setattr(Path, "exists", lambda path: path.name == "X3")
    monkeypatch.delenv("DISPLAY", raising=False)
    return found


@pytest.mark.parametrize(
    ("name", "address"),
    [
        (":7", "\0/tmp/.X11-unix/X7"), (":12.1", "\0/tmp/.X11-unix/X12"),
        ("unix:3", "/tmp/.X11-unix/X3"),
    ],
)  # fmt: skip
def test_a_server_is_knocked_at_before_it_is_opened(
    opened: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    address: str,
) -> None:
    assert open_x_connection(name) == f"a display of {name}"
    assert opened == [address, "closed", ("display", name)]
    # Standard output may be JSON.
    assert capsys.readouterr() == ("", "strange cookies\n")
    monkeypatch.setenv("DISPLAY", name)
    assert open_x_connection() == open_x_connection("") == f"a display of {name}"
    assert open_x_connection(":9") == "a display of :9"


@pytest.mark.parametrize(
    "name", ["host:7", "HDMI-1", ":", "7", ":7.", "tcp:7", ":x", "localhost:10.0"]
)
def test_a_server_of_another_machine_is_refused(opened: list[Any], name: str) -> None:
    with pytest.raises(ConfigError, match=r"is not the name of an X server .*write \":7\""):
        open_x_connection(name)
    with pytest.raises(ConfigError, match=r"DISPLAY is not set \(start pdcd-x\.service"):
        open_x_connection()
    assert opened == []


@pytest.mark.parametrize(
    "fault", [ConnectionRefusedError("refused"), FileNotFoundError("no such file")]
)
def test_a_server_that_nobody_hears_is_lost(opened: list[Any], fault: OSError) -> None:
    Knock.fault = fault
    with pytest.raises(ServerLost, match=r":7 does not answer: .*systemctl status pdcd-x"):
        open_x_connection(":7")
    assert opened[1:] == ["closed"]


@pytest.mark.parametrize(
    ("fault", "raised"),
    [
        (error.DisplayConnectionError(":7", "no"), ServerLost), (OSError("no"), ServerLost),
        (error.ConnectionClosedError("server"), ServerLost), (ValueError("a fault of ours"),
        ValueError),
    ],
)  # fmt: skip
def test_failures_of_the_library_are_our_own_errors(
    opened: list[Any],
    monkeypatch: pytest.MonkeyPatch,
    fault: Exception,
    raised: type[Exception],
) -> None:
    def fail(name: str) -> Any:
        raise fault

    monkeypatch.setattr(xconnection, "Display", fail)
    with pytest.raises(raised):
        open_x_connection(":7")
    if not isinstance(fault, error.DisplayConnectionError):
        with pytest.raises(raised), guard_x_calls(SimpleNamespace(get_display_name=lambda: ":7")):
            raise fault


@pytest.mark.parametrize(
    ("fault", "hidden"),
    [(None, True), (error.ConnectionClosedError("server"), True), (OSError(), True),
     (ValueError(), False)],
)  # fmt: skip
def test_a_connection_is_closed_whatever_its_state(fault: Exception | None, hidden: bool) -> None:
    done: list[str] = []

    def close() -> None:
        done.append("display")
        if fault is not None:
            raise fault

    inner = SimpleNamespace(socket=SimpleNamespace(close=lambda: done.append("socket")))
    display = SimpleNamespace(close=close, display=inner)
    if hidden:
        close_x_connection(display)
        assert done == ["display", "socket"]
    else:
        with pytest.raises(ValueError):
            close_x_connection(display)
