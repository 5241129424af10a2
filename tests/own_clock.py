"""A clock that a test moves, in the place of the machine's, for what waits by `pdcd.presenter`."""

from __future__ import annotations

import time
from typing import Protocol

import pytest

from pdcd.presenter import clocks


class Timed(Protocol):
    """Has a time of its own."""

    now_ns: int


def keep_time(monkeypatch: pytest.MonkeyPatch, owner: Timed) -> None:
    """Let it be `owner.now_ns` everywhere; whoever sleeps moves it on, and is not kept waiting."""

    def sleep_until(t_ns: int) -> None:
        owner.now_ns = max(owner.now_ns, t_ns)

    monkeypatch.setattr(time, "monotonic_ns", lambda: owner.now_ns)
    monkeypatch.setattr(clocks, "wait_until_ns", sleep_until)
