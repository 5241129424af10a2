"""Stands in for the display process: its end of the line, its time, and how it ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from pdcd.child import MessageLine
from pdcd.panels.map import Map
from pdcd.presenter import client
from pdcd.presenter.client import DisplayProcess
from pdcd.presenter.messages import REQUESTS, DisplayReply, DisplayRequest, Open, PanelMode, Ready
from pdcd.presenter.options import X11Options
from tests.child_rig import Children, Clock, Process

READY = Ready("clock", 60.0, {"renderer": "none"})
HANG_S = 3.0


class Bench:
    """Starts one process; `clock` is the time, `pulses` the signs of life."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, children: Children) -> None:
        self.children, self.clock, self.pulses = children, Clock(monkeypatch), 0
        self.connected: list[Any] = []
        self.made: list[DisplayProcess] = []
        self.first: tuple[DisplayReply, ...] = (READY,)
        children.on_start = self._start
        monkeypatch.setattr(client, "open_x_connection", self._connect)
        monkeypatch.setattr(
            client, "close_x_connection", lambda name: self.connected.append((name, "x"))
        )

    @property
    def process(self) -> Process:
        return self.children.last

    @property
    def far(self) -> MessageLine[DisplayRequest]:
        return self.process.lines[0]

    def _start(self, process: Process) -> None:
        process.line(REQUESTS)
        self.answer(*self.first)

    def _connect(self, name: str) -> str:
        self.connected.append(name)
        return name

    def pulse(self) -> None:
        self.pulses += 1

    def started(self, *replies: DisplayReply, **options: Any) -> DisplayProcess:
        """A display process, which begins with these replies."""
        self.first = replies or (READY,)
        return self.started_by(None, **options)

    def started_by(self, look: Callable[[], object] | None, **options: Any) -> DisplayProcess:
        """The same, begun by somebody who may wait no longer."""
        mode = PanelMode(Map.filling((8, 6)), 60.0)
        settings = X11Options(projector="A", mask="B", hang_s=HANG_S, display=":7", **options)
        self.made.append(DisplayProcess(Open(settings, mode, mode), self.pulse, look))
        return self.made[-1]

    def answer(self, *replies: DisplayReply) -> None:
        for reply in replies:
            self.far.send(reply)

    def heard(self) -> tuple[Any, int | None]:
        return self.far.receive_with_fd()
