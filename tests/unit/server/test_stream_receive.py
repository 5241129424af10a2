"""What comes over one accepted socket: bytes, descriptors, and its end."""

from __future__ import annotations

import array
import asyncio
import os
import socket
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager

import pytest

from pdcd.server.stream import ReceivedData, Stream


@contextmanager
def pair() -> Iterator[tuple[Stream, socket.socket]]:
    near, far = socket.socketpair()
    with near, far:
        yield Stream(near), far


def play(scene: Callable[[Stream, socket.socket], Awaitable[None]]) -> None:
    async def whole() -> None:
        with pair() as (stream, far):
            await asyncio.wait_for(scene(stream, far), 60.0)

    asyncio.run(whole())


def closed(fds: list[int]) -> int:
    """Close them, and tell how many there were."""
    for fd in fds:
        os.fstat(fd)
        assert not os.get_inheritable(fd)
        os.close(fd)
    return len(fds)


def test_bytes_come_with_their_descriptors() -> None:
    async def scene(stream: Stream, far: socket.socket) -> None:
        socket.send_fds(far, [b"two"], [0, 1])
        came = await stream.receive()
        assert (came.data, closed(came.fds), came.lost) == (b"two", 2, False)
        socket.send_fds(far, [b"all"], [0] * 16)
        came = await stream.receive()
        assert (came.data, closed(came.fds), came.lost) == (b"all", 16, False)
        far.sendall(b"none")
        assert await stream.receive() == ReceivedData(b"none", [], False)

    play(scene)


def test_of_more_than_16_descriptors_it_is_told_that_some_are_lost() -> None:
    async def scene(stream: Stream, far: socket.socket) -> None:
        socket.send_fds(far, [b"x"], [0] * 17)
        came = await stream.receive()
        assert came.lost and closed(came.fds) == 16

    play(scene)


def test_other_messages_of_the_kernel_are_no_descriptors() -> None:
    async def scene(stream: Stream, far: socket.socket) -> None:
        near = stream._sock
        near.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        fds = array.array("i", [0])
        far.sendmsg([b"x"], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, fds)])
        came = await stream.receive()
        assert (came.data, closed(came.fds)) == (b"x", 1)

    play(scene)


def test_so_much_is_taken_at_a_time() -> None:
    async def scene(stream: Stream, far: socket.socket) -> None:
        sent = asyncio.create_task(asyncio.to_thread(far.sendall, b"x" * 70_000))
        sizes: list[int] = []
        while sum(sizes) < 70_000:
            sizes.append(len((await stream.receive()).data))
        await sent
        assert max(sizes) <= 65_536

    play(scene)


def test_who_waits_for_bytes_is_woken_by_them_by_the_end_and_by_a_cut() -> None:
    async def scene(stream: Stream, far: socket.socket) -> None:
        waits = asyncio.create_task(stream.receive())
        await asyncio.sleep(0.001)
        assert not waits.done()
        far.sendall(b"late")
        assert (await waits).data == b"late"
        waits = asyncio.create_task(stream.receive())
        await asyncio.sleep(0.001)
        stream.cut()
        assert stream.is_cut and await waits == ReceivedData(b"", [], False)
        far.close()
        assert await stream.receive() == ReceivedData(
            b"", [], False
        )  # without a look at the socket
        stream.cut()  # once more, though the client was first

    play(scene)


def test_the_end_of_the_stream_is_empty() -> None:
    async def scene(stream: Stream, far: socket.socket) -> None:
        far.shutdown(socket.SHUT_WR)
        assert await stream.receive() == ReceivedData(b"", [], False)
        assert not stream.is_cut
        await stream.send(b"still heard")
        assert far.recv(100) == b"still heard"

    play(scene)


def test_nobody_is_held_up_by_a_client_that_never_stops() -> None:
    async def scene(stream: Stream, far: socket.socket) -> None:
        far.sendall(b"x" * 1000)
        others = 0

        async def other() -> None:
            nonlocal others
            others += 1

        task = asyncio.create_task(other())
        await stream.receive()  # bytes are there already
        assert others == 1
        await task

    play(scene)


def test_a_client_that_has_gone_is_told_by_an_error() -> None:
    async def scene(stream: Stream, far: socket.socket) -> None:
        far.close()
        with pytest.raises(OSError, match="Broken pipe"):
            await stream.send(b"nobody")
        stream.close()
        assert stream._sock.fileno() == -1

    play(scene)
