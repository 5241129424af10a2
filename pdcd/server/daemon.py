"""`pdcd serve`: from the first line of the log to the last, and the life signs in between.

The socket is claimed before a device is touched, so that two daemons never share a rig; clients
that come early wait in its backlog until the engine has started. Whatever ends the daemon, the
running job ends first (with the panels black and the shutter closed), then the engine.
"""

from __future__ import annotations

import asyncio
import logging
import signal
import time
from collections.abc import Callable
from pathlib import Path

from pdcd.bench.folders import socket_path, state_dir
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError, PdcdError
from pdcd.runs.events import ENDS, THINNED, Decoded, Event, Progress
from pdcd.server import log
from pdcd.server.access import Access
from pdcd.server.connections import Server
from pdcd.server.jobs import EngineLike, Job
from pdcd.server.listening import claimed
from pdcd.server.methods import Methods
from pdcd.server.notify import Notifier, watchdog_s
from pdcd.server.runner import Runner
from pdcd.server.worker import Worker

logger = logging.getLogger(__name__)

EngineFactory = Callable[[Config], EngineLike]

EXIT_DONE, EXIT_CONFIG, EXIT_FAILED = 0, 2, 5
"""Exit codes, as everywhere in pdcd."""

STATUS_INTERVAL_NS = 1_000_000_000
"""Least time between two progress lines to the service manager."""


def run(config: Config, *, socket: Path | None = None, engine_factory: EngineFactory) -> int:
    """Serve until SIGTERM or SIGINT; returns the exit code.

    `socket` overrides the path in the configuration; a socket passed by the service manager
    overrides both. 0: ended on a signal; 2: the configuration is wrong, or another daemon
    answers on the socket; 5: the rig could not be started.
    """
    log.to_stderr()
    return asyncio.run(_run(config, socket, engine_factory))


async def _run(config: Config, socket: Path | None, engine_factory: EngineFactory) -> int:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    try:
        await serve(config, socket=socket, engine_factory=engine_factory, stop=stop)
    except PdcdError as err:
        logger.error("cannot serve: %s", err)
        return EXIT_CONFIG if isinstance(err, ConfigError) else EXIT_FAILED
    return EXIT_DONE


async def serve(
    config: Config,
    *,
    socket: Path | None,
    engine_factory: EngineFactory,
    stop: asyncio.Event,
) -> None:
    """Serve until `stop` is set. Raises PdcdError when the socket or the rig cannot be had."""
    notifier = Notifier()
    worker = Worker()
    try:
        with claimed(socket or socket_path(config), config.server) as sock:
            access = Access.to(sock, config.server)
            server = Server(sock, access, connections=config.limits.connections)
            try:
                notifier.send("STATUS=starting the rig")
                engine = await worker.call(engine_factory, config)
                try:
                    await worker.call(engine.start)
                    logger.info("ready socket=%s", sock.getsockname())
                    await _serve(config, engine, worker, server, notifier, stop)
                finally:
                    # Also after a failed start, which may have connected one device of three.
                    await worker.call(engine.stop)
            finally:
                await server.close()
    finally:
        worker.close()
        logger.info("stopped")


async def _serve(
    config: Config,
    engine: EngineLike,
    worker: Worker,
    server: Server,
    notifier: Notifier,
    stop: asyncio.Event,
) -> None:
    """From a started engine to the end of the last job."""
    status = _Status(notifier)

    def publish(job: Job, event: Event) -> None:
        server.publish(job, event)
        status.follow(job, event)

    runner = Runner(engine, worker, publish)
    methods = Methods(
        config,
        engine,
        worker,
        runner,
        description=await worker.call(engine.describe),
        state_dir=state_dir(config),
        connections=lambda: server.connections,
    )
    limit_s = watchdog_s()
    watchdog = asyncio.create_task(feed(notifier, worker, limit_s)) if limit_s else None
    try:
        await server.open(methods)
        notifier.send("READY=1", "STATUS=idle")
        await stop.wait()
        notifier.send("STOPPING=1", "STATUS=stopping")
        await runner.drain()
    finally:
        if watchdog is not None:
            watchdog.cancel()
            await asyncio.gather(watchdog, return_exceptions=True)


async def feed(notifier: Notifier, worker: Worker, limit_s: float) -> None:
    """Tell the watchdog every third of its time (s) that both threads live; never returns.

    That this coroutine runs shows that the loop does; the worker must have beaten meanwhile.
    """
    while True:
        before = worker.beats
        worker.probe()
        await asyncio.sleep(limit_s / 3)
        if worker.beats != before:
            notifier.send("WATCHDOG=1")
        else:
            logger.warning("the engine's thread gives no sign of life")


class _Status:
    """Keeps the STATUS line of the service up to date, without a flood of progress."""

    def __init__(self, notifier: Notifier) -> None:
        self._notifier = notifier
        self._last_ns = 0

    def follow(self, job: Job, event: Event) -> None:
        """Take note of an event of any job."""
        if isinstance(event, THINNED):
            now_ns = time.monotonic_ns()
            if now_ns - self._last_ns < STATUS_INTERVAL_NS:
                return
            self._last_ns = now_ns
        text = f"{job.kind} {event.job} {event.type}"
        if isinstance(event, Progress):
            text = f"{job.kind} {event.job} {event.frame}/{event.frames}"
        elif isinstance(event, Decoded):
            text = f"{job.kind} {event.job} decoding {event.done / event.total:.0%}"
        elif isinstance(event, ENDS):
            text = f"idle, last {job.kind} {event.job} {event.type}"
        self._notifier.send(f"STATUS={text}")
