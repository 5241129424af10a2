"""What the daemon and its work process say to each other, and how it goes over a socket.

Each message is a pickle behind its length, 8 bytes. Both ends are the same program of the same
user, so what comes is trusted; nothing that a client sent is ever read as a pickle.
"""

from __future__ import annotations

import pickle
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pdcd.errors import PdcdError

_HEAD = struct.Struct("<Q")
PIECE_BYTES = 1 << 20
"""Most that is sent or received at a time."""


@dataclass(frozen=True)
class Call:
    """Do that task of the table with these arguments."""

    name: str
    args: tuple[Any, ...]
    kwargs: dict[str, Any]


@dataclass(frozen=True)
class Stop:
    """What is being done is not wanted any more; says nothing to one who does nothing."""


@dataclass(frozen=True)
class Sign:
    """A sign of life; with a `total` above 0 also how much is done, and at what stage."""

    done: float = 0.0
    total: float = 0.0
    stage: str = ""


@dataclass(frozen=True)
class Done:
    """The task is done."""

    value: Any


@dataclass(frozen=True)
class Failed:
    """The task raised; `spent` says that the process has seen better days: replace it."""

    error: PdcdError
    spent: bool = False


def packed(message: object) -> bytes:
    """A message as it goes over the socket."""
    data = pickle.dumps(message, protocol=5)
    return _HEAD.pack(len(data)) + data


class Inbox:
    """Puts messages together from the pieces in which they come."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def take(self, piece: bytes) -> Iterator[Any]:
        """The messages that are complete with this piece."""
        self._buffer += piece
        while len(self._buffer) >= _HEAD.size:
            (length,) = _HEAD.unpack_from(self._buffer)
            end = _HEAD.size + length
            if len(self._buffer) < end:
                return
            message = pickle.loads(memoryview(self._buffer)[_HEAD.size : end])
            del self._buffer[:end]
            yield message
