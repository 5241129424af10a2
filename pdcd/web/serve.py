"""Binds the page to the loopback interface, reports its address, and serves it to the end."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import signal
import socket as sockets
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

from aiohttp import web

from pdcd.errors import ConfigError
from pdcd.web.app import Site
from pdcd.web.asks import DaemonQueries
from pdcd.web.door import BrowserAuth, VisitorConnection, VisitorPlaces
from pdcd.web.news import News
from pdcd.web.shelf import RunShelf

_BACKLOG = 1024
"""Most connections that wait to be accepted."""
_SCARCE_S = 1.0
"""Pause when the system lacks resources to accept a connection, in seconds."""

logger = logging.getLogger(__name__)
_library = logging.getLogger("pdcd.web.library")
# It logs every malformed request at length. We log our own faults ourselves.
_library.disabled = True
SERVER_SETTINGS: Mapping[str, object] = {
    "access_log": None,
    "logger": _library,
    "lingering_time": 0.0,
    "auto_decompress": False,  # a body must not grow by unpacking
    "max_line_size": 1024,
    "max_field_size": 4096,
    "max_headers": 64,
}
"""The library's settings for each connection: sizes in bytes, and features that are off."""


def bind_loopback(host: str, port: int) -> sockets.socket:
    """A listening socket at an address of the loopback interface; port 0 takes a free one.

    Raises ConfigError for any other address, and when it cannot be bound.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError as err:
        raise ConfigError(
            f"{host!r} is no address", hint="give one of the loopback interface: 127.0.0.1 or ::1"
        ) from err
    # A mapped address (::ffff:127.0.0.1) is really one of the other family.
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
        sock.listen(_BACKLOG)
        sock.setblocking(False)
    except (OSError, OverflowError) as err:
        sock.close()
        why = (err.strerror if isinstance(err, OSError) else None) or err
        raise ConfigError(
            f"cannot listen on {host}, port {port}: {why}", hint="choose another with --port"
        ) from err
    return sock


@asynccontextmanager
async def serve_page(sock: sockets.socket, socket: Path, state: Path) -> AsyncIterator[BrowserAuth]:
    """Serve the page on a listening socket for as long as the context lasts.

    socket : the daemon's. state : its state folder, for the list of runs. The value of the context
    has the address to open.
    """
    host, port = sock.getsockname()[:2]
    door, places, asks = BrowserAuth(host, port), VisitorPlaces(), DaemonQueries(socket)
    news = News(socket, asks)
    site = Site(door, places, asks, news, RunShelf(state))
    runner = web.AppRunner(site.app(), handle_signals=False, handler_cancellation=True)
    await runner.setup()
    if runner.server is None:
        raise RuntimeError("a runner that is set up has a server")
    connection = partial(VisitorConnection, places, runner.server, **SERVER_SETTINGS)
    accepting = asyncio.create_task(_accept(sock, places, connection))
    news.start()
    try:
        yield door
    finally:
        accepting.cancel()
        await asyncio.gather(accepting, return_exceptions=True)
        sock.close()
        await news.close()
        places.end()
        await runner.cleanup()


async def _accept(
    sock: sockets.socket, places: VisitorPlaces, connection: Callable[[], asyncio.Protocol]
) -> None:
    """Accept connections, no faster than there are places; never returns."""
    loop = asyncio.get_running_loop()
    while True:
        try:
            came, _ = await loop.sock_accept(sock)
            await loop.connect_accepted_socket(connection, came)
        except ConnectionError:
            continue  # the browser is gone
        except Exception as err:  # mostly too few descriptors
            logger.error("no connection can be accepted: %s", err)
            await asyncio.sleep(_SCARCE_S)
        await asyncio.sleep(places.wait_s())


async def run_page_server(
    sock: sockets.socket, socket: Path, state: Path, tell: Callable[[str], object]
) -> None:
    """Serve until SIGINT or SIGTERM; `tell` is called once, with the address to open."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    async with serve_page(sock, socket, state) as door:
        tell(door.address)
        await stop.wait()
