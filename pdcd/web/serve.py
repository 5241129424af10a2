"""Binding the page to the loopback interface, telling its address, and ending."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import signal
import socket as sockets
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from aiohttp import web

from pdcd.errors import ConfigError
from pdcd.web.app import Site
from pdcd.web.asks import Asks
from pdcd.web.door import Door
from pdcd.web.guard import Guards
from pdcd.web.news import News
from pdcd.web.shelf import Shelf

BACKLOG = 64
"""Connections that wait to be accepted."""
MOST_LINE_BYTES = 1024
"""Longest first line of a request."""
MOST_HEADER_BYTES, MOST_HEADERS = 4096, 64

_library = logging.getLogger("pdcd.web.library")
# It tells of every malformed request at length. Faults of ours are logged by ourselves.
_library.disabled = True


def bound(host: str, port: int) -> sockets.socket:
    """A listening socket at an address of the loopback interface; port 0 takes a free one.

    Raises ConfigError for any other address, and where it cannot be had.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError as err:
        raise ConfigError(
            f"{host!r} is no address", hint="give one of the loopback interface: 127.0.0.1 or ::1"
        ) from err
    # A mapped address (::ffff:127.0.0.1) is one of the other family in disguise.
    if not address.is_loopback or getattr(address, "ipv4_mapped", None) is not None:
        raise ConfigError(
            f"{host} is not an address of the loopback interface, and no other is served",
            hint="leave --host out; from afar, forward the port with ssh -L",
        )
    family = sockets.AF_INET if address.version == 4 else sockets.AF_INET6
    sock = sockets.socket(family, sockets.SOCK_STREAM)
    try:
        sock.setsockopt(sockets.SOL_SOCKET, sockets.SO_REUSEADDR, 1)
        sock.bind((str(address), port))
        sock.listen(BACKLOG)
        sock.setblocking(False)
    except (OSError, OverflowError) as err:
        sock.close()
        why = (err.strerror if isinstance(err, OSError) else None) or err
        raise ConfigError(
            f"cannot listen on {host}, port {port}: {why}", hint="choose another with --port"
        ) from err
    return sock


@asynccontextmanager
async def serving(sock: sockets.socket, socket: Path, state: Path) -> AsyncIterator[Door]:
    """Serve the page on a listening socket for as long as the context lasts.

    socket : the daemon's. state : its state folder, for the list of runs. The door that is given
    knows the address to be opened.
    """
    host, port = sock.getsockname()[:2]
    door, asks = Door(host, port), Asks(socket)
    news = News(socket, asks)

    def protocol() -> asyncio.Protocol:
        if runner.server is None:
            raise RuntimeError("connections are taken once the runner is set up")
        return runner.server()

    guards = Guards(protocol)
    site = Site(door, guards, asks, news, Shelf(state))
    runner = web.AppRunner(
        site.app(),
        handle_signals=False,
        handler_cancellation=True,
        access_log=None,
        logger=_library,
        lingering_time=0.0,
        auto_decompress=False,
        max_line_size=MOST_LINE_BYTES,
        max_field_size=MOST_HEADER_BYTES,
        max_headers=MOST_HEADERS,
    )
    await runner.setup()
    server = await asyncio.get_running_loop().create_server(guards, sock=sock)
    news.start()
    try:
        yield door
    finally:
        server.close()
        await news.close()
        guards.end()
        await runner.cleanup()
        await site.close()
        await asks.close()


async def run(
    sock: sockets.socket, socket: Path, state: Path, tell: Callable[[str], object]
) -> None:
    """Serve until SIGINT or SIGTERM; `tell` is given the address to be opened, once."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    async with serving(sock, socket, state) as door:
        tell(door.address)
        await stop.wait()
