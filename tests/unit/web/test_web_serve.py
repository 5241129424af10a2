"""The socket of the page, and its end: where it listens, by what it ends, and what is then left."""

from __future__ import annotations

import asyncio
import signal
import socket
from pathlib import Path

import pytest

from pdcd.errors import ConfigError
from pdcd.web.serve import bind_loopback, run_page_server, serve_page


def test_a_socket_of_either_family_is_made_for_the_loop() -> None:
    for host, family in (("127.0.0.1", socket.AF_INET), ("::1", socket.AF_INET6)):
        with bind_loopback(host, 0) as sock:
            assert (sock.family, sock.type) == (family, socket.SOCK_STREAM)
            assert not sock.getblocking()
            assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR) == 1
            assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN) == 1
            assert sock.getsockname()[0] == host and sock.getsockname()[1] > 0


def test_any_address_of_the_loopback_will_do_and_what_is_none_is_named() -> None:
    with bind_loopback("127.8.0.1", 0) as sock:
        assert sock.getsockname()[0] == "127.8.0.1"
    with pytest.raises(ConfigError, match="'house' is no address") as caught:
        bind_loopback("house", 0)
    assert "127.0.0.1 or ::1" in str(caught.value.hint)
    with pytest.raises(ConfigError, match=r"10\.0\.0\.1 is not an address") as caught:
        bind_loopback("10.0.0.1", 0)
    assert "ssh -L" in str(caught.value.hint)


def test_why_a_port_cannot_be_had_is_said() -> None:
    with bind_loopback("127.0.0.1", 0) as sock:
        port = sock.getsockname()[1]
        with pytest.raises(ConfigError, match=f"port {port}: Address already in use"):
            bind_loopback("127.0.0.1", port)
    with pytest.raises(ConfigError, match=r"port 65536: .*0-65535"):
        bind_loopback("127.0.0.1", 65536)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_after_the_address_was_told(
    number: signal.Signals, tmp_path: Path
) -> None:
    told: list[str] = []

    def tell(address: str) -> None:
        told.append(address)
        signal.raise_signal(number)

    sock = bind_loopback("127.0.0.1", 0)
    port = sock.getsockname()[1]
    asyncio.run(asyncio.wait_for(run_page_server(sock, tmp_path / "none", tmp_path, tell), 60.0))
    assert len(told) == 1 and told[0].startswith(f"http://127.0.0.1:{port}/#")
    assert sock.fileno() == -1


async def test_when_it_ends_nobody_is_left_connected(tmp_path: Path) -> None:

    sock = bind_loopback("127.0.0.1", 0)
    host, port = sock.getsockname()
    async with serve_page(sock, tmp_path / "none", tmp_path) as door:
        assert door.host == f"{host}:{port}"
        reader, writer = await asyncio.open_connection(host, port)
        writer.write(b"GET / HT")
        await writer.drain()
        await asyncio.sleep(0)
    try:
        assert await asyncio.wait_for(reader.read(), 60.0) == b""
    except ConnectionError:
        pass  # which is an end as well
    writer.close()
    with pytest.raises(ConnectionError):
        await asyncio.open_connection(host, port)
