"""What comes over one accepted socket: bytes, descriptors, and its end."""

from __future__ import annotations

import array
import asyncio
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import NamedTuple

from pdcd.server.stream import ReceivedData, Stream
from tests.coroutines import entered


class Pair(NamedTuple):
    """Our end of a connection, and the client's."""

    stream: Stream
    far: socket.socket


@asynccontextmanager
async def socket_pair() -> AsyncIterator[Pair]:
    near, far = socket.socketpair()
    with near, far:
        async with asyncio.timeout(60.0):
            yield Pair(Stream(near), far)


in_pair = entered(pair=socket_pair)


def closed(fds: list[int]) -> int:
    """Close them, and tell how many there were."""
    for fd in fds:
        os.fstat(fd)
        assert not os.get_inheritable(fd)
        os.close(fd)
    return len(fds)


@in_pair
async def test_other_messages_of_the_kernel_are_no_descriptors(pair: Pair) -> None:
    near = pair.stream._sock
    near.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
    fds = array.array("i", [0])
    pair.far.sendmsg([b"x"], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, fds)])
    came = await pair.stream.receive()
    assert (came.data, closed(came.fds)) == (b"x", 1)


@in_pair
async def test_who_waits_for_bytes_is_woken_by_them_by_the_end_and_by_a_cut(pair: Pair) -> None:
    waits = asyncio.create_task(pair.stream.receive())
    await asyncio.sleep(0.001)
    assert not waits.done()
    pair.far.sendall(b"late")
    assert (await waits).data == b"late"
    waits = asyncio.create_task(pair.stream.receive())
    await asyncio.sleep(0.001)
    pair.stream.cut()
    assert pair.stream.is_cut and await waits == ReceivedData(b"", [], False)
    pair.far.close()
    assert await pair.stream.receive() == ReceivedData(
        b"", [], False
    )  # without a look at the socket
    pair.stream.cut()  # once more, though the client was first


@in_pair
async def test_nobody_is_held_up_by_a_client_that_never_stops(pair: Pair) -> None:
    pair.far.sendall(b"x" * 1000)
    others = 0

    async def other() -> None:
        nonlocal others
        others += 1

    task = asyncio.create_task(other())
    await pair.stream.receive()  # bytes are there already
    assert others == 1
    await task


async def test_who_still_sends_hears_the_last_word_and_no_reset() -> None:
    near, far = socket.socketpair()
    with near, far:
        stream = Stream(near)
        socket.send_fds(far, [b"unread " * 5000], [far.fileno()])
        far.sendall(b"unread " * 5000)
        await stream.send(b"the last word\n")
        stream.close()
        assert far.recv(100) == b"the last word\n"
        assert far.recv(100) == b""
