"""Questions to the daemon, each on a connection of its own and in a thread of its own.

So a daemon that goes and comes back needs nothing from us, and one that hangs holds up nobody else.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pdcd.client import Client
from pdcd.web.turns import Turns

AT_A_TIME = 3
"""Questions at a time: the daemon has few places for the connections of one user."""
ANSWER_S = 10.0
"""How long an answer may take that needs no device, in seconds."""
ENGINE_S = 60.0
"""The same where the rig is needed: a plan, a quick photo, the end of a job."""
CONNECT_S = 5.0
"""How long the daemon may take to greet, in seconds."""

Params = Mapping[str, object]


class Asks:
    """Asks the daemon on a socket; used from one event loop."""

    def __init__(self, socket: Path) -> None:
        self._socket = socket
        self._turns = Turns(AT_A_TIME, "the daemon")
        self._kept = Turns(1, "the daemon")

    async def ask(
        self, method: str, params: Params | None = None, *, answer_s: float = ANSWER_S
    ) -> Any:
        """The answer, in JSON types. Raises the PdcdError that the daemon gave, BusyError where too
        much is asked at a time, and Unreachable."""
        return await self._turns.do(self._call, method, params, answer_s)

    async def cancel(self, job: str) -> Any:
        """End a job; has a place kept for it, so that it need not wait for a plan."""
        return await self._kept.do(self._call, "capture.cancel", {"job": job}, ENGINE_S)

    def _call(self, method: str, params: Params | None, answer_s: float) -> Any:
        with Client(self._socket, CONNECT_S) as client:
            return client.call(method, params, timeout_s=answer_s)
