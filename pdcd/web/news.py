"""News that pages get without asking: whether the daemon is there, its state, events of jobs.

A thread listens to the daemon's events, and reconnects by itself when the daemon is back. Each open
page reads from a queue of its own; a page that does not read is dropped, and asks anew.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import deque
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

from pdcd.api.progress import describe_event, read_share_done
from pdcd.client import Client
from pdcd.errors import PdcdError
from pdcd.files.text import encode_json
from pdcd.protocol.events import ENDS, THINNED, Event, JobQueued, JobStarted, encode_event
from pdcd.web.asks import CONNECT_S, DaemonQueries
from pdcd.web.pages import name_fields

_RETRY_S = 1.0
"""Time between two attempts to reach the daemon, in seconds."""
_REMEMBERED = 100
"""Events of the last job that a page gets when it opens."""
UNREAD = 256
"""Messages that may wait for a page before it is dropped; thinned ones only up to half of that."""
PAGES = 8
"""Most pages at a time."""
BEAT_S = 15.0
"""Time between two signs of life to a page, in seconds."""

BEAT = b": alive\n\n"


class TooManyPagesError(Exception):
    """No more pages can get news."""


class News:
    """Collects news and sends it to every page; used from one event loop."""

    def __init__(self, socket: Path, asks: DaemonQueries) -> None:
        self._socket = socket
        self._asks = asks
        self._loop = asyncio.get_running_loop()
        self._pages: set[asyncio.Queue[bytes | None]] = set()
        self._events: deque[tuple[bool, dict[str, Any]]] = deque(maxlen=_REMEMBERED)
        self._here = False
        self._why = "not reached yet"
        self._visit = 0
        self._status: Any = None
        self._ended = threading.Event()
        self._client: Client | None = None
        self._lock = threading.Lock()
        self._refresh: asyncio.Task[None] | None = None
        self._stale = False
        self._thread = threading.Thread(target=self._listen, name="pdcd-web-news", daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    async def close(self) -> None:
        """Stop listening, and end all pages."""
        self._ended.set()
        with self._lock:
            if self._client is not None:
                self._client.close()
        if self._refresh is not None:
            self._refresh.cancel()
            await asyncio.gather(self._refresh, return_exceptions=True)
        for page in self._pages:
            _end(page)
        if self._thread.ident is not None:
            await asyncio.to_thread(self._thread.join, CONNECT_S + 1.0)

    async def page(self) -> AsyncGenerator[bytes, None]:
        """The server-sent events for one page, until it leaves or falls behind.

        Raises TooManyPagesError.
        """
        if len(self._pages) >= PAGES:
            raise TooManyPagesError
        queue: asyncio.Queue[bytes | None] = asyncio.Queue()
        for message in (self._state(), *(event for _, event in self._events)):
            queue.put_nowait(make_message(message))
        self._pages.add(queue)
        try:
            while True:
                try:
                    async with asyncio.timeout(BEAT_S):
                        data = await queue.get()
                except TimeoutError:
                    data = BEAT
                if data is None:
                    return
                yield data
        finally:
            self._pages.discard(queue)

    def _state(self) -> dict[str, Any]:
        return {
            "what": "state",
            "here": self._here,
            "why": self._why,
            "visit": self._visit,
            "status": self._status,
        }

    def _tell(self, message: dict[str, Any], *, thinned: bool = False) -> None:
        data = make_message(message)
        for page in self._pages:
            if page.qsize() >= UNREAD:
                _end(page)
            elif not thinned or page.qsize() < UNREAD // 2:
                page.put_nowait(data)

    # In the loop's thread.

    def _arrived(self) -> None:
        self._here, self._why, self._status = True, "", None
        self._visit += 1
        self._events.clear()
        self._look()

    def _gone(self, why: str) -> None:
        if (self._here, self._why) != (False, why):
            self._here, self._why, self._status = False, why, None
            self._tell(self._state())

    def _heard(self, event: Event) -> None:
        thinned = isinstance(event, THINNED)
        done, total = read_share_done(event) or (None, 0.0)
        share = None if done is None or not total else done / total
        message = {
            "what": "event",
            **name_fields(encode_event(event)),
            "words": name_fields(describe_event(event)),
            "share": share,
        }
        if (
            self._events
            and self._events[-1][1]["job"] != event.job
            and isinstance(event, JobQueued)
        ):
            self._forget()
        if thinned and self._events and self._events[-1][0]:
            self._events.pop()
        self._events.append((thinned, message))
        self._tell(message, thinned=thinned)
        if isinstance(event, (JobQueued, JobStarted, *ENDS)):
            self._look()

    def _forget(self) -> None:
        """Forget events of ended jobs, as a new job has come."""
        ended = {e["job"] for _, e in self._events if e["type"] in ("done", "failed", "cancelled")}
        kept = [each for each in self._events if each[1]["job"] not in ended]
        self._events.clear()
        self._events.extend(kept)

    def _look(self) -> None:
        """Ask for the state of the rig, and once more if this is called again meanwhile."""
        self._stale = True
        if self._refresh is None or self._refresh.done():
            self._refresh = self._loop.create_task(self._ask_status())

    async def _ask_status(self) -> None:
        while self._stale:
            self._stale = False
            try:
                status = await self._asks.ask("rig.status")
            except (PdcdError, ConnectionError):
                return  # the listener notices, too, and says so
            if self._here:
                self._status = status
                self._tell(self._state())

    # In the listener's own thread.

    def _listen(self) -> None:
        while not self._ended.is_set():
            try:
                with Client(self._socket, CONNECT_S) as client:
                    self._follow(client)
                why = "the daemon went away"
            except (PdcdError, OSError) as err:
                why = str(err)
            self._in_loop(self._gone, why)
            self._ended.wait(_RETRY_S)

    def _follow(self, client: Client) -> None:
        with self._lock:
            self._client = client
        try:
            if self._ended.is_set():
                return
            # Subscribe first, so that nothing is missed between the state and the events.
            client.call("events.subscribe", {"jobs": "all"})
            self._in_loop(self._arrived)
            for event in client.events("all"):
                self._in_loop(self._heard, event)
        finally:
            with self._lock:
                self._client = None

    def _in_loop(self, function: Any, *args: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            self._loop.call_soon_threadsafe(function, *args)


def make_message(message: Any) -> bytes:
    """One server-sent event, in JSON."""
    return b"data: " + encode_json(message) + b"\n\n"


def _end(page: asyncio.Queue[bytes | None]) -> None:
    """End a page: drop what waits for it, and let it read no more."""
    while not page.empty():
        page.get_nowait()
    page.put_nowait(None)
