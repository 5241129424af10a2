"""One accepted socket: bytes and descriptors in, lines out.

The streams of asyncio drop descriptors that come with the bytes, so this module does the reading.
"""

from __future__ import annotations

import array
import asyncio
import contextlib
import socket
from typing import NamedTuple

from pdcd.protocol.messages import MAX_FDS

_READ_BYTES = 65536
"""Most bytes that are taken from a socket at a time."""

_CONTROL_BYTES = socket.CMSG_LEN(MAX_FDS * array.array("i").itemsize)


class ReceivedData(NamedTuple):
    """What was received at a time: `data` is empty at the end of the stream. The receiver owns
    `fds`; `lost` means that more of them came than could be taken."""

    data: bytes
    fds: list[int]
    lost: bool


class Stream:
    """Owns a connected socket; used from the event loop only."""

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        self._sock = sock
        self.is_cut = False
        """True once nothing more is to be read or written."""

    async def receive(self) -> ReceivedData:
        """Wait for bytes. Raises OSError when the connection broke."""
        # A client that never stops sending must not block the loop.
        await asyncio.sleep(0)
        while not self.is_cut:
            try:
                # Not recv_fds, which drops its flags in some versions of Python.
                data, control, flags, _ = self._sock.recvmsg(
                    _READ_BYTES, _CONTROL_BYTES, socket.MSG_CMSG_CLOEXEC
                )
            except (BlockingIOError, InterruptedError):
                await self._ready()
            else:
                return ReceivedData(data, _fds_in(control), bool(flags & socket.MSG_CTRUNC))
        return ReceivedData(b"", [], False)

    async def send(self, line: bytes, fd: int | None = None) -> None:
        """Hand a line to the kernel, when it has room, with a descriptor at its first byte, which
        stays the caller's. Raises OSError when the client has gone."""
        if fd is not None:
            rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [fd]))]
            while True:
                try:
                    line = line[self._sock.sendmsg([line], rights) :]
                    break
                except (BlockingIOError, InterruptedError):
                    await self._ready(writing=True)
        await asyncio.get_running_loop().sock_sendall(self._sock, line)

    def cut(self) -> None:
        """End both directions at once; those who wait in `receive` or `send` are woken."""
        self.is_cut = True
        with contextlib.suppress(OSError):  # the client was first
            self._sock.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the socket. Nobody may wait for it any more.

        Unread bytes of the client are read first: otherwise its kernel reports a reset, and many a
        client then never reads the last message.
        """
        self.cut()
        with contextlib.suppress(OSError):
            while self._sock.recv(_READ_BYTES):  # it ends: after `cut` no more can come
                pass
        self._sock.close()

    async def _ready(self, *, writing: bool = False) -> None:
        loop = asyncio.get_running_loop()
        ready = loop.create_future()
        add, remove = (
            (loop.add_writer, loop.remove_writer)
            if writing
            else (loop.add_reader, loop.remove_reader)
        )
        add(self._sock, lambda: None if ready.done() else ready.set_result(None))
        try:
            await ready
        finally:
            remove(self._sock)


def _fds_in(control: list[tuple[int, int, bytes]]) -> list[int]:
    fds = array.array("i")
    for level, kind, data in control:
        if (level, kind) == (socket.SOL_SOCKET, socket.SCM_RIGHTS):
            fds.frombytes(data[: len(data) - len(data) % fds.itemsize])
    return fds.tolist()
