"""`pdcd serve`: from the first line of the log to the last, and the life signs in between.

Socket and state folder are claimed before a device is touched, so that two daemons never share a
rig or a folder; clients that come early wait in the backlog until the engine has started. Whatever
ends the daemon, the running job ends first (with the panels black and the shutter closed), then the
engine; all of it in time, whatever a driver does (`pdcd.server.ending`).
"""

from __future__ import annotations

import asyncio
import ctypes
import logging
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from socket import socket as Socket  # noqa: N812 - `socket` is a path here

from pdcd.bench.folders import find_socket_path, find_state_dir
from pdcd.bench.tables import Config, ServerConfig
from pdcd.errors import Cancelled, ConfigError, DriverUnavailable, PdcdError
from pdcd.protocol.events import ENDS, THINNED, DecodingProgress, Event, PlanningProgress, Progress
from pdcd.server import log
from pdcd.server.access import Access
from pdcd.server.aside import call_in_thread
from pdcd.server.connections import Server
from pdcd.server.ending import catch_end
from pdcd.server.engine_like import EngineLike
from pdcd.server.jobs import Job
from pdcd.server.listening import open_listener
from pdcd.server.lock import hold_lock_file
from pdcd.server.methods import Methods
from pdcd.server.notify import Notifier, watchdog_s
from pdcd.server.runner import Runner
from pdcd.server.worker import EngineThread

logger = logging.getLogger(__name__)

_EngineFactory = Callable[[Config], EngineLike]

_EXIT_DONE, _EXIT_CONFIG, _EXIT_FAILED = 0, 2, 5
"""Exit codes, as everywhere in pdcd."""

GROUPS_S = 10.0
"""How long looking up the groups of the configuration may take, in seconds."""

_STATUS_INTERVAL_NS = 1_000_000_000
"""Least time between two progress lines to the service manager."""

_M_ARENA_MAX, _M_MMAP_THRESHOLD = -8, -3
"""Options of glibc's mallopt: the most arenas of free memory, and the size in bytes from which a
block is mapped on its own, and unmapped once it is free."""
_MAPPED_BYTES = 2**17
_TRIM_S = 5.0


def run_daemon(
    config: Config,
    *,
    socket: Path | None = None,
    engine_factory: _EngineFactory,
    verbose: bool = False,
) -> int:
    """Serve until SIGTERM, SIGINT or SIGHUP; returns the exit code.

    `socket` overrides the path in the configuration; a socket passed by the service manager
    overrides both. `verbose` logs everything at a terminal, too. 0: ended on a signal; 2: the
    configuration is wrong, or another daemon has the socket or the state folder; 5: the rig could
    not be started.
    """
    log.send_to_stderr(verbose=verbose)
    _share_free_memory()
    return asyncio.run(_run(config, socket, engine_factory))


def _share_free_memory() -> None:
    """Let all threads use memory that any of them frees, and return large blocks to the system.
    Otherwise the C library keeps for each thread as much as it ever had, and gradually larger
    blocks. Does nothing where the C library is another one."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)
        mallopt(_M_MMAP_THRESHOLD, _MAPPED_BYTES)


async def _return_memory() -> None:
    """Return free pages between blocks in use to the system from time to time; never returns."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", lambda _: None)
    while True:
        await asyncio.sleep(_TRIM_S)
        trim(0)


async def _run(config: Config, socket: Path | None, engine_factory: _EngineFactory) -> int:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    with catch_end(lambda: loop.call_soon_threadsafe(stop.set)) as ending:

        def make_engine(config: Config) -> EngineLike:
            engine = engine_factory(config)
            ending.watch(engine)
            return engine

        try:
            await serve_daemon(config, socket=socket, engine_factory=make_engine, stop=stop)
        except PdcdError as err:
            if stop.is_set() and isinstance(err, Cancelled):
                return _EXIT_DONE
            logger.error("cannot serve: %s", err)
            wrong = isinstance(err, ConfigError | DriverUnavailable)
            return _EXIT_CONFIG if wrong else _EXIT_FAILED
    return _EXIT_DONE


async def serve_daemon(
    config: Config,
    *,
    socket: Path | None,
    engine_factory: _EngineFactory,
    stop: asyncio.Event,
) -> None:
    """Serve until `stop` is set. Raises PdcdError when the socket or the rig cannot be used."""
    notifier = Notifier()
    worker = EngineThread()
    try:
        with (
            open_listener(socket or find_socket_path(config), config.server) as sock,
            _state(config),
        ):
            server = Server(sock, await _access(sock, config.server), config.limits)
            try:
                notifier.send("STATUS=starting the rig")
                engine = await worker.call(engine_factory, config)
                try:
                    await worker.call(engine.start)
                    logger.info("ready socket=%s", sock.getsockname(), extra=log.FOR_PEOPLE)
                    await _serve(config, engine, worker, server, notifier, stop)
                finally:
                    # Also after a failed start, which may have connected one device of three.
                    await worker.call(engine.stop)
            finally:
                await server.close()
    finally:
        worker.close()
        logger.info("stopped")


def _state(config: Config) -> AbstractContextManager[None]:
    """The state folder, made where it is missing, for this daemon alone.

    `pdcd capture --local` does not lock it: runs never share a folder, and devices protect
    themselves.
    """
    folder = find_state_dir(config)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise ConfigError(
            f"cannot make the state folder {folder}: {err.strerror or err}",
            hint="choose another by --state-dir or [server] state_dir",
        ) from err
    hint = "stop it first, or give this one --state-dir"
    return hold_lock_file(folder / "daemon.lock", f"the state folder {folder}", hint)


async def _access(sock: Socket, config: ServerConfig) -> Access:
    """Who may do what. Raises ConfigError for groups that are unknown, or not found in time."""
    try:
        async with asyncio.timeout(GROUPS_S):
            return await call_in_thread(Access.to, sock, config)
    except TimeoutError as err:
        raise ConfigError(
            f"the groups in [server] could not be looked up in {GROUPS_S:g} s",
            hint="give them by number",
        ) from err


async def _serve(
    config: Config,
    engine: EngineLike,
    worker: EngineThread,
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
        state_dir=find_state_dir(config),
        connections=lambda: server.connections,
    )
    limit_s = watchdog_s()
    tasks = [asyncio.create_task(_return_memory())]
    if limit_s:
        tasks.append(asyncio.create_task(tell_watchdog(notifier, worker, limit_s)))
    try:
        server.open(methods)
        notifier.send("READY=1", "STATUS=idle")
        await stop.wait()
        notifier.send("STOPPING=1", "STATUS=stopping")
        await runner.drain()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def tell_watchdog(notifier: Notifier, worker: EngineThread, limit_s: float) -> None:
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
            if now_ns - self._last_ns < _STATUS_INTERVAL_NS:
                return
            self._last_ns = now_ns
        text = f"{job.kind} {event.job} {event.type}"
        if isinstance(event, Progress):
            text = f"{job.kind} {event.job} {event.frame}/{event.frames}"
        elif isinstance(event, PlanningProgress):
            text = f"{job.kind} {event.job} planning {event.done / event.total:.0%}"
        elif isinstance(event, DecodingProgress):
            text = f"{job.kind} {event.job} decoding {event.done / event.total:.0%}"
        elif isinstance(event, ENDS):
            text = f"idle, last {job.kind} {event.job} {event.type}"
        self._notifier.send(f"STATUS={text}")
