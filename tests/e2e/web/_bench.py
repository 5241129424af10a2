"""A daemon with the mock bench and the page before it, in a thread of their own."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pdcd.bench.tables import Config
from pdcd.capture.engine import Engine
from pdcd.server.daemon import serve_daemon
from pdcd.web.serve import bind_loopback, serve_page

PATIENCE_S = 60.0


@dataclass
class Bench:
    """address : to be opened once. socket, state : the daemon's. `stop` and `start` are for the
    daemon alone; the page stays."""

    address: str
    socket: Path
    state: Path
    config: Config
    loop: asyncio.AbstractEventLoop
    ends: asyncio.Event
    task: asyncio.Task[None] | None = None

    async def _start(self) -> None:
        self.ends.clear()
        self.task = asyncio.create_task(
            serve_daemon(
                self.config, socket=self.socket, engine_factory=Engine.from_config, stop=self.ends
            )
        )

    async def _stop(self) -> None:
        self.ends.set()
        if self.task is not None:
            await self.task

    def start(self) -> None:
        asyncio.run_coroutine_threadsafe(self._start(), self.loop).result(PATIENCE_S)

    def stop(self) -> None:
        asyncio.run_coroutine_threadsafe(self._stop(), self.loop).result(PATIENCE_S)


@contextmanager
def bench(folder: Path, config: Config) -> Iterator[Bench]:
    """Both, until the context ends; the daemon runs."""
    ready, over = threading.Event(), asyncio.Event()
    box: list[Bench] = []
    socket, state = folder / "s", folder / "state"

    async def body() -> None:
        loop = asyncio.get_running_loop()
        async with serve_page(bind_loopback("127.0.0.1", 0), socket, state) as door:
            here = Bench(door.address, socket, state, config, loop, asyncio.Event())
            box.append(here)
            await here._start()
            ready.set()
            await over.wait()
            await here._stop()

    thread = threading.Thread(target=asyncio.run, args=(body(),))
    thread.start()
    try:
        assert ready.wait(PATIENCE_S)
        yield box[0]
    finally:
        if box:
            box[0].loop.call_soon_threadsafe(over.set)
        thread.join(PATIENCE_S)
    assert not thread.is_alive()
