"""PTP transactions over one USB port: command, data either way, response, and back in step.

A container is a header of 12 bytes and its parameters or data. On the way in, one transfer may hold
only a header, header and data, or data directly followed by the response; a container of whole
packets may or may not be followed by an empty packet. All of these are accepted.

Transfers are read into one buffer that is kept, which saves a copy: the data of a reply that came
in one transfer is a view of that buffer, valid until the next transaction.
"""

from __future__ import annotations

import array
from dataclasses import dataclass

from pdcd.driver import Clock

from .codes import ContainerType, ResponseCode
from .containers import (
    HEADER_BYTES,
    WireError,
    pack_data_header,
    pack_message,
    parse_header,
    parse_message,
)
from .faults import TransactionMismatch, WireFault, WireTimeout
from .usb_port import UsbPort

TRANSACTION_S = 8.0
"""Longest that a transaction may take, with all its transfers."""

BLOCK_B = 1 << 20
"""Bytes of an object to ask for at a time; 5 MiB upset some bodies."""

_BUFFER_B = BLOCK_B + 1024
_SMALL_B = 1024
_MOST_DATA_B = 2 * BLOCK_B
"""Most data of one transaction: no block of a photo is longer; event lists are far shorter."""
_MOST_STRAY = 8
_DRAIN_S = 0.1
_STATUS_S, _STATUS_STEP_NS = 2.0, 100_000_000


@dataclass(frozen=True)
class TransactionReply:
    """The response of a transaction, and its data; `data` is valid until the next transaction."""

    code: int
    params: tuple[int, ...]
    data: memoryview


class Transport:
    """Transactions over a claimed port; raises `WireFault` when one cannot be completed.

    After a fault the two sides may be out of step: call `back_in_step` before the next transaction.
    A transaction that was interrupted by a cancel is given up at the next one.
    """

    def __init__(self, port: UsbPort, clock: Clock) -> None:
        self._port = port
        self._clock = clock
        self._buffer = array.array("B", bytes(_BUFFER_B))
        self._small = array.array("B", bytes(_SMALL_B))
        self._surplus = b""
        self._next_id = 0
        self._until_ns = 0
        self._broken_off = False

    @property
    def name(self) -> str:
        """Where the camera is."""
        return self._port.name

    def restart_ids(self) -> None:
        """Give the next transaction number 0, as OpenSession requires."""
        self._next_id = 0

    def transact(
        self,
        code: int,
        params: tuple[int, ...] = (),
        data: bytes | None = None,
        timeout_s: float = TRANSACTION_S,
    ) -> TransactionReply:
        """Send an operation and return the camera's response to it, whatever it is."""
        if self._broken_off:
            self.back_in_step()
        self._until_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        self._broken_off = True
        try:
            reply = self._transact(code, params, data)
        except WireFault:
            self._broken_off = False  # the ladder knows what to do
            raise
        self._broken_off = False
        return reply

    def _transact(self, code: int, params: tuple[int, ...], data: bytes | None) -> TransactionReply:
        number = self._next_id
        self._next_id = (number + 1) % 0xFFFFFFFF
        command = pack_message(ContainerType.COMMAND, code, number, params)
        self._port.write(command, self._left_s())
        if data is not None:
            self._port.write(pack_data_header(code, number, len(data)) + data, self._left_s())
        try:
            return self._receive(code, number)
        except WireError as err:
            raise TransactionMismatch(err.message) from err

    def back_in_step(self) -> None:
        """Give up the last transaction: cancel, wait until the camera is ready, empty the line.

        Raises WireFault when the camera does not get ready.
        """
        self._surplus, self._broken_off = b"", False
        self._port.cancel((self._next_id - 1) % 0xFFFFFFFF)
        until_ns = self._clock.now_ns() + round(_STATUS_S * 1e9)
        while self._clock.now_ns() < until_ns:
            if self._port.status() == ResponseCode.OK:
                break
            self._clock.sleep_until_ns(self._clock.now_ns() + _STATUS_STEP_NS)
        else:
            raise WireTimeout("does not get ready after a cancelled transaction")
        for _ in range(_MOST_STRAY):
            try:
                if self._port.read_into(self._buffer, _DRAIN_S) == 0:
                    return
            except WireTimeout:
                return
        raise TransactionMismatch("goes on sending after a cancelled transaction")

    def device_reset(self) -> None:
        """Make the camera forget session and transaction."""
        self._surplus = b""
        self._port.device_reset()

    def usb_reset(self) -> None:
        """Reset the port and release it."""
        self._port.usb_reset()

    def close(self) -> None:
        """Release the port."""
        self._port.close()

    def _left_s(self) -> float:
        """Time that is left for the transaction. Raises WireTimeout when it is over."""
        left_ns = self._until_ns - self._clock.now_ns()
        if left_ns <= 0:
            raise WireTimeout("takes too long over one answer")
        return left_ns * 1e-9

    def _receive(self, code: int, number: int) -> TransactionReply:
        buffer, payload = self._buffer, memoryview(b"")
        for _ in range(_MOST_STRAY):
            first = self._transfer(buffer)
            if len(first) == 0:  # the empty packet after a container of whole packets
                continue
            head = parse_header(first)
            if head.kind is not ContainerType.DATA:
                message, taken = parse_message(first)
                self._surplus = bytes(first[taken:])
                if message.kind is ContainerType.EVENT:
                    continue
                if message.kind is ContainerType.RESPONSE and message.transaction == number:
                    return TransactionReply(message.code, message.parameters, payload)
            elif (head.code, head.transaction) == (code, number) and buffer is self._buffer:
                payload = self._data(first, head.payload_bytes)
                buffer = self._small  # the data stays where it is
                continue
            raise TransactionMismatch(
                f"sent {head.kind.name} {head.code:#06x} of transaction {head.transaction} "
                f"within {code:#06x}, transaction {number}"
            )
        raise TransactionMismatch("sends containers without end")

    def _data(self, first: memoryview, need: int | None) -> memoryview:
        """The payload of the data container that begins with `first`, `need` bytes long; with None
        it ends with a short packet."""
        last, piece = first, first[HEADER_BYTES:]
        if not piece and need != 0:  # the header came alone
            last = piece = self._transfer(self._buffer)
        if need is None:
            whole = bytearray(piece)
            while not self._short(last):
                last = self._transfer(self._buffer)
                whole += last
                if len(whole) > _MOST_DATA_B:
                    raise TransactionMismatch("sends data without end")
            return memoryview(whole)
        if need > _MOST_DATA_B:
            raise TransactionMismatch(f"announces {need} bytes of data")
        if len(piece) >= need:
            self._surplus = bytes(piece[need:])
            return piece[:need]
        whole = bytearray(piece)
        while len(whole) < need:
            if self._short(last):
                raise TransactionMismatch(f"sent {len(whole)} of {need} bytes of data")
            last = self._transfer(self._buffer)
            whole += last
        self._surplus = bytes(whole[need:])
        return memoryview(whole)[:need]

    def _transfer(self, buffer: array.array[int]) -> memoryview:
        """The bytes of one transfer, or those left over from the last one."""
        if self._surplus:
            kept, self._surplus = self._surplus, b""
            return memoryview(kept)
        return memoryview(buffer)[: self._port.read_into(buffer, self._left_s())]

    def _short(self, transfer: memoryview) -> bool:
        return len(transfer) == 0 or len(transfer) % self._port.packet_b != 0
