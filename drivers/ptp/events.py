"""The records that an EOS body returns for `Operation.EOS_GET_EVENT`.

One data phase holds records one behind the other, each a u32 size (of the whole record), a u32
code and a body; a record of size 8 and code 0 ends them. Offsets from the start of a record::

    C181 ObjectAddedEx (card)   08 handle  0C storage  10 format  1C size  20 parent  28 name
    C186 RequestObjectTransfer  08 handle  0C format   14 size    1C name
    C189 PropValueChanged       08 property  0C value
    C18A AvailListChanged       08 property  0C type (3: list of u32)  10 count  14 values
    C194 BulbExposureTime       08 u32

The format is not published; the offsets are those that libgphoto2 reads from real bodies. Names
are ASCII with a terminating zero.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass

from .codes import EosEvent, Property
from .containers import Buffer, WireError
from .datasets import Reader

_RECORD_BYTES = 8
_END = struct.pack("<II", _RECORD_BYTES, EosEvent.END)
_LIST_U32 = 3
_FORMAT_ENTRY_BYTES = 16
_MOST_RECORDS, _MOST_CHOICES = 20_000, 1024
"""Most records of one list of events, and most values of one setting; bodies have some hundred of
either."""


@dataclass(frozen=True)
class ObjectAdded:
    """A file is there: on the card, or in the camera's memory, waiting to be fetched."""

    handle: int
    format: int
    size_bytes: int
    name: str
    on_card: bool
    storage: int = 0
    parent: int = 0

    def pack(self) -> bytes:
        """Bytes of the record."""
        name = self.name.encode("ascii", "replace") + b"\0"
        name += b"\0" * (-len(name) % 4)
        if self.on_card:
            body = struct.pack(
                "<IIHHIIIII", self.handle, self.storage, self.format, 0, 0, 0, self.size_bytes,
                self.parent, 0,
            )  # fmt: skip
            return _record(EosEvent.OBJECT_ADDED_EX, body + name)
        body = struct.pack("<IHHIII", self.handle, self.format, 0, 0, self.size_bytes, 0)
        return _record(EosEvent.REQUEST_OBJECT_TRANSFER, body + name)


@dataclass(frozen=True)
class PropValue:
    """The present value of a property; `data` are its bytes, nearly always one u32."""

    prop: int
    data: bytes

    @classmethod
    def of(cls, prop: int, value: int) -> PropValue:
        """A property of one u32."""
        return cls(prop, struct.pack("<I", value))

    @property
    def value(self) -> int:
        """The u32 value. Raises WireError when there are fewer than four bytes."""
        return Reader(self.data, f"value of property 0x{self.prop:04X}").u32()

    def pack(self) -> bytes:
        """Bytes of the record."""
        return _record(EosEvent.PROP_VALUE_CHANGED, struct.pack("<I", self.prop) + bytes(self.data))


@dataclass(frozen=True)
class AvailList:
    """The values a property can be set to now; an empty list means that it cannot be set.

    `values` are u32. For `Property.IMAGE_FORMAT` they are empty and `packed` holds the bytes of
    each entry, to be sent back unchanged (`drivers.ptp.datasets.pack_property_bytes`).
    """

    prop: int
    values: tuple[int, ...] = ()
    packed: tuple[bytes, ...] = ()

    def pack(self) -> bytes:
        """Bytes of the record."""
        count = len(self.packed) or len(self.values)
        body = struct.pack("<III", self.prop, _LIST_U32, count)
        body += b"".join(self.packed) or struct.pack(f"<{count}I", *self.values)
        return _record(EosEvent.AVAIL_LIST_CHANGED, body)


@dataclass(frozen=True)
class PlainRecord:
    """Any other record: its code and the bytes after it."""

    code: int
    data: bytes = b""

    def pack(self) -> bytes:
        """Bytes of the record."""
        return _record(self.code, self.data)


EosRecord = ObjectAdded | PropValue | AvailList | PlainRecord


def pack_events(records: Iterable[EosRecord]) -> bytes:
    """Pack all records, followed by the end record."""
    return b"".join(record.pack() for record in records) + _END


def parse_events(data: Buffer) -> list[EosRecord]:
    """Read all records of one `EOS_GET_EVENT`; the list is empty when nothing happened.

    Records with unnamed codes become `PlainRecord`. Some bodies leave the end record out, or send
    no data at all: the end of `data` also counts as the end. Raises WireError when a record is cut
    short, is smaller than its own fields, or states a size beyond the data.
    """
    take = Reader(data, "EOS events")
    records: list[EosRecord] = []
    while take.left_bytes:
        size, code = take.u32(), take.u32()
        if size < _RECORD_BYTES:
            raise WireError(f"EOS events: record 0x{code:04X} says it is {size} bytes long")
        body = take.take(size - _RECORD_BYTES)
        if code == EosEvent.END:
            break
        if len(records) == _MOST_RECORDS:
            raise WireError(f"EOS events: more than {_MOST_RECORDS} in one list")
        records.append(_parse_record(code, body))
    return records


def is_raw_only(packed: Buffer) -> bool:
    """Whether an entry of `Property.IMAGE_FORMAT` makes a RAW file and nothing else.

    An entry is a u32 count (1 or 2), then as many pieces of four u32: 0x10 (their length in
    bytes), type (1 JPEG, 6 RAW), size (0 large), compression. Raises WireError.
    """
    take = Reader(packed, "image format")
    count = take.u32()
    kinds = []
    for _ in range(min(count, 2)):
        piece = Reader(take.take(_FORMAT_ENTRY_BYTES), "image format")
        piece.u32()
        kinds.append(piece.u32())
    return kinds == [6]


def _parse_record(code: int, body: memoryview) -> EosRecord:
    take = Reader(body, f"EOS event 0x{code:04X}")
    if code == EosEvent.OBJECT_ADDED_EX:
        handle, storage, kind = take.u32(), take.u32(), take.u16()
        take.take(10)
        size, parent = take.u32(), take.u32()
        take.take(4)
        return ObjectAdded(handle, kind, size, _name(take), True, storage, parent)
    if code == EosEvent.REQUEST_OBJECT_TRANSFER:
        handle, kind = take.u32(), take.u16()
        take.take(6)
        size = take.u32()
        take.take(4)
        return ObjectAdded(handle, kind, size, _name(take), False)
    if code == EosEvent.PROP_VALUE_CHANGED:
        return PropValue(take.u32(), bytes(take.take(take.left_bytes)))
    if code == EosEvent.AVAIL_LIST_CHANGED:
        return _parse_list(take)
    return PlainRecord(code, bytes(body))


def _parse_list(take: Reader) -> EosRecord:
    prop, kind, count = take.u32(), take.u32(), take.u32()
    if count > _MOST_CHOICES:
        raise WireError(f"EOS events: property 0x{prop:04X} may be one of {count} values")
    if prop == Property.IMAGE_FORMAT:
        packed = []
        for _ in range(count):
            start = bytes(take.take(4))
            entries = int.from_bytes(start, "little")
            if entries not in (1, 2):
                raise WireError(f"image format: an entry of {entries} files")
            packed.append(start + bytes(take.take(_FORMAT_ENTRY_BYTES * entries)))
        return AvailList(prop, (), tuple(packed))
    if kind != _LIST_U32:  # a form of list that pdcd has no use for
        return PlainRecord(
            EosEvent.AVAIL_LIST_CHANGED,
            struct.pack("<III", prop, kind, count) + bytes(take.take(take.left_bytes)),
        )
    return AvailList(prop, struct.unpack(f"<{count}I", take.take(4 * count)))


def _name(take: Reader) -> str:
    raw = bytes(take.take(take.left_bytes)).partition(b"\0")[0]
    return raw.decode("ascii", "replace")


def _record(code: int, body: bytes) -> bytes:
    return struct.pack("<II", _RECORD_BYTES + len(body), code) + body
