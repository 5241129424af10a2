"""What is on the other side of a ``line://`` port."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

import serial

from pdcd.bench.devices import Clock

LINES: dict[str, FakeLine] = {}


class Edge(NamedTuple):
    """A line was set (also to what it was)."""

    t_ns: int
    line: str
    level: bool


@dataclass
class FakeLine:
    """A port's lines and bytes. `on_edge` may be a camera that listens."""

    clock: Clock
    edges: list[Edge] = field(default_factory=list)
    cts: Callable[[], bool] = lambda: False
    dsr: Callable[[], bool] = lambda: False
    answer: Callable[[bytes], bytes] = lambda _: b""
    received: list[bytes] = field(default_factory=list)
    on_edge: Callable[[Edge], None] = lambda _: None
    unplugged: bool = False
    opened: int = 0

    def set(self, line: str, level: bool) -> None:
        """Write an edge down."""
        edge = Edge(self.clock.now_ns(), line, level)
        self.edges.append(edge)
        self.on_edge(edge)

    def levels(self, line: str) -> list[bool]:
        """What one line was set to, in order."""
        return [edge.level for edge in self.edges if edge.line == line]


@contextmanager
def fake_line(name: str, clock: Clock) -> Iterator[FakeLine]:
    """A port ``line://name`` for as long as the context lasts."""
    package = "tests.fake_serial"
    serial.protocol_handler_packages.append(package)
    LINES[name] = FakeLine(clock)
    try:
        yield LINES[name]
    finally:
        del LINES[name]
        serial.protocol_handler_packages.remove(package)
