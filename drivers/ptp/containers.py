"""PTP containers as they go over USB: a header of 12 bytes, then parameters or data.

::

    offset  0   u32  length of the whole container, header included
            4   u16  type: 1 command, 2 data, 3 response, 4 event
            6   u16  code of the operation, response or event
            8   u32  transaction id
           12        up to five u32 parameters, or the data

All little-endian (USB still image class, revision 1.0, annex D). A length of 0xFFFFFFFF means that
the sender does not know the length: the container then ends with a short packet.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from pdcd.driver import DecodeError

from .codes import ContainerType

HEADER_BYTES = 12
_UNKNOWN_LENGTH = 0xFFFFFFFF
MAX_PARAMETERS = 5

_HEADER = struct.Struct("<IHHI")

Buffer = bytes | bytearray | memoryview


class WireError(DecodeError):
    """Bytes from the camera are not valid PTP: damaged, cut short or foreign."""

    def __init__(self, message: str) -> None:
        super().__init__(message, device="camera", hint="the connection or the camera is faulty")


@dataclass(frozen=True)
class Header:
    """The first 12 bytes. `length_bytes` includes them; None if the sender left it open."""

    length_bytes: int | None
    kind: ContainerType
    code: int
    transaction: int

    @property
    def payload_bytes(self) -> int | None:
        """Bytes after the header; None if the sender left the length open."""
        return None if self.length_bytes is None else self.length_bytes - HEADER_BYTES


@dataclass(frozen=True)
class Message:
    """A command, response or event: a code with up to five u32 parameters."""

    kind: ContainerType
    code: int
    transaction: int
    parameters: tuple[int, ...] = ()


def pack_message(
    kind: ContainerType, code: int, transaction: int, parameters: tuple[int, ...] = ()
) -> bytes:
    """Pack a command, response or event. Parameters are u32, at most five (else ValueError)."""
    if kind is ContainerType.DATA or len(parameters) > MAX_PARAMETERS:
        raise ValueError(f"{kind!r} with {len(parameters)} parameters is no message")
    length = HEADER_BYTES + 4 * len(parameters)
    header = _HEADER.pack(length, kind, code, transaction)
    return header + struct.pack(f"<{len(parameters)}I", *parameters)


def pack_data_header(code: int, transaction: int, payload_bytes: int) -> bytes:
    """Header of a data container; the payload follows it in the same transfer.

    A payload that does not fit 32 bits goes with the length left open.
    """
    length = min(HEADER_BYTES + payload_bytes, _UNKNOWN_LENGTH)
    return _HEADER.pack(length, ContainerType.DATA, code, transaction)


def parse_header(data: Buffer) -> Header:
    """Read the header at the start of `data`; what follows may be incomplete.

    Raises WireError when fewer than 12 bytes are there, the type is unknown, or the length is
    less than that of the header.
    """
    if len(data) < HEADER_BYTES:
        raise WireError(f"a container of {len(data)} bytes has no whole header")
    length, kind, code, transaction = _HEADER.unpack_from(data)
    if not ContainerType.COMMAND <= kind <= ContainerType.EVENT:
        raise WireError(f"container type {kind} is not one of 1 to 4")
    if length == _UNKNOWN_LENGTH and kind == ContainerType.DATA:
        return Header(None, ContainerType.DATA, code, transaction)
    if length < HEADER_BYTES:
        raise WireError(f"a container says it is {length} bytes long, less than its header")
    return Header(length, ContainerType(kind), code, transaction)


def parse_message(data: Buffer) -> tuple[Message, int]:
    """Read the command, response or event at the start of `data`.

    Returns it and its length in bytes: `data` may hold more after it, which is left to the caller.
    Raises WireError when it is a data container, is cut short, or its length is not that of a
    header with up to five parameters.
    """
    header = parse_header(data)
    if header.kind is ContainerType.DATA or header.length_bytes is None:
        raise WireError("a data container came where a message was due")
    count, rest = divmod(header.length_bytes - HEADER_BYTES, 4)
    if rest or count > MAX_PARAMETERS:
        raise WireError(f"a message of {header.length_bytes} bytes has no whole parameters")
    if len(data) < header.length_bytes:
        raise WireError(f"a message of {header.length_bytes} bytes was cut off at {len(data)}")
    parameters = struct.unpack_from(f"<{count}I", data, HEADER_BYTES)
    message = Message(header.kind, header.code, header.transaction, parameters)
    return message, header.length_bytes
