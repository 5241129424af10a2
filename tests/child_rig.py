"""Stands in for child processes: what was started, the far end of its line, and how it ends."""

from __future__ import annotations

import os
import select
import subprocess
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest

from pdcd.child import Codec, MessageLine


class Process:
    """Stands in for `subprocess.Popen`: lives until it is killed, or told to `die`.

    command, inherits, how : what it was started with; its end of the line is the last word.
    done : what was done to it, in order. status : what it ends with when it is killed.
    stubborn : whether it has not ended yet however long one waits.
    """

    def __init__(self, number: int, command: Sequence[str], pass_fds: Sequence[int], how: Any):
        self.pid, self.how = 100 + number, how
        self.command, self.inherits = list(command), tuple(pass_fds[:-1])
        assert self.command[-1] == str(pass_fds[-1])
        self.far_fd = os.dup(pass_fds[-1])
        self.done: list[Any] = []
        self.returncode: int | None = None
        self.status, self.stubborn = -9, False
        self.lines: list[MessageLine[Any]] = []

    def line(self, codec: Codec[Any]) -> MessageLine[Any]:
        """Its end of the line, which it closes when it dies."""
        self.lines.append(MessageLine.at(self.far_fd, codec))
        return self.lines[-1]

    def die(self, status: int | None) -> None:
        """End with that status; None closes its end, and lives on."""
        self.returncode = status
        self.close()

    def close(self) -> None:
        if self.lines:
            self.lines[-1].close()
        elif self.far_fd >= 0:
            os.close(self.far_fd)
        self.far_fd = -1

    def poll(self) -> int | None:
        return self.returncode

    def kill(self) -> None:
        if self.returncode is None:
            self.done.append("kill")
            self.returncode = self.status

    def wait(self, timeout: float | None = None) -> int:
        self.done.append(("wait", timeout))
        if self.stubborn or (self.returncode is None and timeout is not None):
            raise subprocess.TimeoutExpired("it", timeout or 0.0)
        assert self.returncode is not None
        return self.returncode


class Children:
    """All processes that are started meanwhile, each given to `on_start`; with `refusal` none."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.started: list[Process] = []
        self.refusal: OSError | None = None
        self.on_start: Callable[[Process], object] = lambda process: None
        monkeypatch.setattr("pdcd.child.subprocess.Popen", self._start)

    @property
    def last(self) -> Process:
        return self.started[-1]

    def _start(self, command: Sequence[str], *, pass_fds: Sequence[int], **how: Any) -> Process:
        if self.refusal is not None:
            raise self.refusal
        self.started.append(Process(len(self.started), command, pass_fds, how))
        self.on_start(self.last)
        return self.last

    def close(self) -> None:
        for process in self.started:
            process.close()


def stand_ins(monkeypatch: pytest.MonkeyPatch) -> Iterator[Children]:
    """The body of a fixture."""
    made = Children(monkeypatch)
    yield made
    made.close()


class Clock:
    """A time that stands, and passes only where somebody waits in vain."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s, self._patch = 100.0, monkeypatch
        monkeypatch.setattr("pdcd.child.time.monotonic", lambda: self.now_s)

    def silence(self, step_s: float, *, deaf: bool = False) -> list[float | None]:
        """From now on nothing is heard, nor taken where `deaf`; each look takes that long.

        Returns the looks, in seconds.
        """
        looks_s: list[float | None] = []
        clock = self

        class Poller:
            def register(self, line: object, event: int) -> None:
                self.ready = event == select.POLLOUT and not deaf

            def poll(self, wait_ms: float | None) -> list[Any]:
                if self.ready:
                    return [1]
                looks_s.append(None if wait_ms is None else wait_ms / 1000)
                clock.now_s += step_s
                return []

        self._patch.setattr("pdcd.child.select.poll", Poller)
        return looks_s
