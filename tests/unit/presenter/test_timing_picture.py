"""The picture of a display's times, and the kernel's calls as they are made."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.presenter import drm_calls
from pdcd.presenter.drm_calls import Linux
from pdcd.presenter.messages import Ready
from pdcd.presenter.timing import Timing, histogram


def timing() -> Timing:
    """Three refreshes, two of them late by one and by two."""
    seconds = np.array([0.010, 0.020, 0.030])
    return Timing(Ready("drm", 100.0, {}), seconds, np.array([0, 1, 2]), seconds, seconds,
                  seconds / 10, 0.001)  # fmt: skip


class Axes:
    """One plot: what it was told, by name."""

    def __init__(self) -> None:
        self.told: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        def tell(*words: Any, **how: Any) -> None:
            self.told[name] = (*words, how)

        return tell


class Figure(Axes):
    """A figure of two plots beside each other."""

    made: list[Figure]

    def __init__(self, **how: Any) -> None:
        super().__init__()
        self.how, self.axes = how, (Axes(), Axes())
        self.made.append(self)

    def subplots(self, rows: int, columns: int) -> tuple[Axes, Axes]:
        assert (rows, columns) == (1, 2)
        return self.axes


def test_a_picture_has_both_times_in_milliseconds_and_says_what_was_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    Figure.made = []
    monkeypatch.setitem(sys.modules, "matplotlib.figure", SimpleNamespace(Figure=Figure))
    histogram(timing(), Path("a.png"))
    (made,) = Figure.made
    for axes, milliseconds, label in zip(
        made.axes, ([10.0, 20.0, 30.0], [1.0, 2.0, 3.0]), ("refresh to refresh / ms",
        "processor time of a refresh / ms"), strict=True,
    ):  # fmt: skip
        shown, how = axes.told["hist"]
        np.testing.assert_allclose(shown, milliseconds)
        # A single late one among thousands is to be seen.
        assert how["log"] is True and how["bins"] == 80 and how["color"].startswith("#")
        assert axes.told["set_xlabel"][0] == label
        assert axes.told["set_ylabel"][0] == "refreshes"
        sizes = [axes.told[f"set_{axis}label"][1]["fontsize"] for axis in "xy"]
        assert sizes == [9, 9] and axes.told["tick_params"] == ({"labelsize": 8},)
        assert axes.told["grid"] == ({"alpha": 0.3},)
    title, how = made.told["suptitle"]
    assert title == "3 refreshes, 3 missed, time source drm" and how == {"fontsize": 10}
    assert made.told["savefig"] == (Path("a.png"), {"dpi": 110})
    assert made.how == {"figsize": (8.0, 3.2), "layout": "constrained"}


def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ConfigError, match=r"a histogram needs matplotlib \(pip install 'pdcd\[pl"):
        histogram(timing(), Path("a.png"))


# The kernel's calls.


def test_a_call_that_a_signal_interrupts_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    faults: list[OSError] = [InterruptedError(), InterruptedError()]

    def ioctl(*words: Any) -> None:
        asked.append(words)
        if faults:
            raise faults.pop(0)

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    wish = drm_calls.GetSequence(crtc_id=41)
    Linux().call(5, 77, wish)
    assert asked == [(5, 77, wish)] * 3
    Linux().call(5, 78)
    assert asked[3:] == [(5, 78, 0)]
    faults.append(OSError(errno.ENODEV, "gone"))
    with pytest.raises(OSError, match="gone"):
        Linux().call(5, 77, wish)
    assert len(asked) == 5


@pytest.mark.parametrize(
    ("ready", "answer", "found"),
    [(False, b"event", b""), (True, b"event", b"event"), (True, BlockingIOError(), b""),
     (True, OSError(errno.ENODEV, "gone"), None)],
)  # fmt: skip
def test_events_are_read_once_they_are_there(
    monkeypatch: pytest.MonkeyPatch, ready: bool, answer: Any, found: bytes | None
) -> None:
    done: list[Any] = []

    class Poller:
        def register(self, fd: int, events: int) -> None:
            done.append((fd, events))

        def poll(self, wait_ms: float) -> list[Any]:
            done.append(wait_ms)
            return [1] if ready else []

    def read(fd: int, size: int) -> bytes:
        done.append((fd, size))
        if isinstance(answer, OSError):
            raise answer
        found: bytes = answer
        return found

    monkeypatch.setattr(select, "poll", Poller)
    monkeypatch.setattr(os, "read", read)
    if found is None:
        with pytest.raises(OSError, match="gone"):
            Linux().read(5, 0.25)
    else:
        assert Linux().read(5, 0.25) == found
    assert done == [(5, select.POLLIN), 250.0, *[(5, 4096)] * ready]


def test_a_card_is_opened_for_calls_without_waiting_and_for_no_other_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Any] = []

    def opened(*words: Any) -> int:
        asked.append(words)
        return 9

    monkeypatch.setattr(os, "open", opened)
    assert Linux().open("/dev/dri/card0") == 9
    assert asked == [("/dev/dri/card0", os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)]
    assert (drm_calls.RELATIVE, drm_calls.SEQUENCE_EVENT, drm_calls.EVENT_HEADER) == (1, 3, 8)
