"""Stands in for the display process: its end of the talk, its time, and how it ends."""

from __future__ import annotations

import subprocess
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.panels.map import Map
from pdcd.presenter import client
from pdcd.presenter.client import DisplayProcess
from pdcd.presenter.messages import (
    Channel,
    Mode,
    Open,
    Ready,
    Reply,
    Request,
    pair,
)
from pdcd.presenter.options import Options

READY = Ready("clock", 60.0, {"renderer": "none"})
HANG_S = 3.0


class Child:
    """Stands in for the process: `ended` is its status, None while it runs."""

    pid = 4711

    def __init__(self, words: list[str], **how: Any) -> None:
        self.words, self.how = words, how
        self.ended: int | None = None
        self.status = -9
        self.kills = 0
        self.waits: list[float | None] = []
        self.stubborn = False

    def poll(self) -> int | None:
        return self.ended

    def kill(self) -> None:
        self.kills += 1
        self.ended = self.status

    def wait(self, timeout_s: float | None = None) -> int:
        self.waits.append(timeout_s)
        if timeout_s is not None and self.stubborn:
            raise subprocess.TimeoutExpired("it", timeout_s)
        self.ended = self.status if self.ended is None else self.ended
        return self.ended

    @property
    def returncode(self) -> int | None:
        return self.ended


class Bench:
    """Starts processes; `theirs` is the far end of the talk, `now_s` the time of the near one."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.mine, self.theirs = pair()
        self.passed = self.theirs.dup()
        self.far: Channel[Request] = Channel(self.theirs, Request)
        self.child: Child | None = None
        self.now_s, self.pulses = 100.0, 0
        self.connected: list[Any] = []
        monkeypatch.setattr(client, "pair", lambda: (self.mine, self.passed))
        monkeypatch.setattr(client, "connect", self._connect)
        monkeypatch.setattr(client, "disconnect", lambda name: self.connected.append((name, "x")))
        monkeypatch.setattr(subprocess, "Popen", self._start)
        monkeypatch.setattr(client, "time", SimpleNamespace(monotonic=lambda: self.now_s))

    def _start(self, words: list[str], **how: Any) -> Child:
        self.child = Child(words, **how)
        return self.child

    def _connect(self, name: str) -> str:
        self.connected.append(name)
        return name

    def pulse(self) -> None:
        self.pulses += 1

    def started(self, *replies: Reply, **options: Any) -> DisplayProcess:
        self.answer(*(replies or (READY,)))
        mode = Mode(Map.filling((8, 6)), 60.0)
        settings = Options(projector="A", mask="B", hang_s=HANG_S, display=":7", **options)
        return DisplayProcess(Open(settings, mode, mode), self.pulse)

    def answer(self, *replies: Reply) -> None:
        for reply in replies:
            self.far.send(reply)

    def heard(self) -> tuple[Any, int | None]:
        return self.far.receive()

    def close(self) -> None:
        for end in (self.mine, self.theirs, self.passed):
            end.close()


def child_of(bench: Bench) -> Child:
    assert bench.child is not None
    return bench.child


def silent(bench: Bench, process: DisplayProcess, look_s: float = 0.5) -> list[float]:
    """Let nothing be answered, and every look take that long; returns the looks, in ms."""
    looks_ms: list[float] = []

    def poll(wait_ms: float) -> list[Any]:
        looks_ms.append(wait_ms)
        bench.now_s += look_s
        return []

    process._poller = SimpleNamespace(poll=poll)  # type: ignore[assignment]
    return looks_ms
