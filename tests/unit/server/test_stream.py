"""The end of a connection, as its client sees it."""

from __future__ import annotations

import asyncio
import socket

from pdcd.server.stream import Stream


def test_who_still_sends_hears_the_last_word_and_no_reset() -> None:
    async def scenario() -> None:
        near, far = socket.socketpair()
        with near, far:
            stream = Stream(near)
            socket.send_fds(far, [b"unread " * 5000], [far.fileno()])
            far.sendall(b"unread " * 5000)
            await stream.send(b"the last word\n")
            stream.close()
            assert far.recv(100) == b"the last word\n"
            assert far.recv(100) == b""

    asyncio.run(scenario())


def test_a_reset_by_the_client_does_not_keep_a_stream_from_closing() -> None:
    async def scenario() -> None:
        near, far = socket.socketpair()
        stream = Stream(near)
        await stream.send(b"nobody reads this")
        far.close()
        stream.close()
        assert near.fileno() == -1

    asyncio.run(scenario())
