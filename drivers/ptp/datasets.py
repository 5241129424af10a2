"""PTP datasets: the contents of the data phase, packed and parsed.

Strings are a count of UTF-16 units, including the terminating zero, then the units; an empty string
is the single byte 0. Arrays are a u32 count, then the elements (ISO 15740 clause 5.3). Every count
is checked against the bytes that are there before anything is taken or allocated.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from .codes import Operation
from .containers import Buffer, WireError

_NAME_CHARACTERS = 254  # a u8 counts them together with the terminating zero


class Reader:
    """Takes values one after the other from bytes; WireError when they run out."""

    def __init__(self, data: Buffer, what: str) -> None:
        self._data = memoryview(data)
        self._what = what
        self._at = 0

    @property
    def left_bytes(self) -> int:
        """Bytes not taken yet."""
        return len(self._data) - self._at

    def take(self, count: int) -> memoryview:
        """Take the next `count` bytes, as a view."""
        if count > self.left_bytes:
            raise WireError(
                f"{self._what}: {count} bytes are due at {self._at}, {self.left_bytes} are there"
            )
        view = self._data[self._at : self._at + count]
        self._at += count
        return view

    def u8(self) -> int:
        """Next unsigned byte."""
        return self.take(1)[0]

    def u16(self) -> int:
        """Next unsigned 16-bit number."""
        return int.from_bytes(self.take(2), "little")

    def u32(self) -> int:
        """Next unsigned 32-bit number."""
        return int.from_bytes(self.take(4), "little")

    def array_u16(self) -> tuple[int, ...]:
        """Next array of u16."""
        count = self.u32()
        return struct.unpack(f"<{count}H", self.take(2 * count))

    def string(self) -> str:
        """Next string, without its terminating zero and anything after it."""
        units = self.take(2 * self.u8())
        try:
            text = str(units, "utf-16-le")
        except UnicodeDecodeError as err:
            raise WireError(f"{self._what}: a string is not UTF-16") from err
        return text.partition("\0")[0]


def pack_string(text: str) -> bytes:
    """Pack a string of at most 254 UTF-16 units (longer: ValueError)."""
    if not text:
        return b"\0"
    units = text.encode("utf-16-le")
    if len(units) > 2 * _NAME_CHARACTERS:
        raise ValueError(f"a PTP string holds {_NAME_CHARACTERS} units, not {len(units) // 2}")
    return bytes([len(units) // 2 + 1]) + units + b"\0\0"


def pack_u16s(values: Iterable[int]) -> bytes:
    """Pack an array of u16."""
    numbers = tuple(values)
    return struct.pack(f"<I{len(numbers)}H", len(numbers), *numbers)


def pack_u32s(values: Iterable[int]) -> bytes:
    """Pack an array of u32."""
    numbers = tuple(values)
    return struct.pack(f"<I{len(numbers)}I", len(numbers), *numbers)


@dataclass(frozen=True)
class DeviceInfo:
    """A camera's description of itself (ISO 15740 clause 5.5.1); codes as plain integers."""

    manufacturer: str
    model: str
    device_version: str
    serial: str
    operations: tuple[int, ...]
    events: tuple[int, ...] = ()
    properties: tuple[int, ...] = ()
    capture_formats: tuple[int, ...] = ()
    image_formats: tuple[int, ...] = ()
    standard_version: int = 100
    vendor_extension_id: int = 0
    vendor_extension_version: int = 0
    vendor_extension: str = ""
    functional_mode: int = 0

    def supports(self, *operations: Operation) -> bool:
        """Whether the camera lists all of these operations."""
        return set(operations) <= set(self.operations)

    def pack(self) -> bytes:
        """Bytes of the dataset."""
        return b"".join(
            (
                struct.pack("<HIH", self.standard_version, self.vendor_extension_id,
                            self.vendor_extension_version),
                pack_string(self.vendor_extension),
                struct.pack("<H", self.functional_mode),
                pack_u16s(self.operations),
                pack_u16s(self.events),
                pack_u16s(self.properties),
                pack_u16s(self.capture_formats),
                pack_u16s(self.image_formats),
                pack_string(self.manufacturer),
                pack_string(self.model),
                pack_string(self.device_version),
                pack_string(self.serial),
            )
        )  # fmt: skip

    @classmethod
    def parse(cls, data: Buffer) -> DeviceInfo:
        """Read the dataset; bytes after it are ignored. Raises WireError."""
        take = Reader(data, "DeviceInfo")
        standard, vendor, version = take.u16(), take.u32(), take.u16()
        extension, mode = take.string(), take.u16()
        operations, events, properties = take.array_u16(), take.array_u16(), take.array_u16()
        capture_formats, image_formats = take.array_u16(), take.array_u16()
        manufacturer, model = take.string(), take.string()
        device_version, serial = take.string(), take.string()
        return cls(
            manufacturer, model, device_version, serial, operations, events, properties,
            capture_formats, image_formats, standard, vendor, version, extension, mode,
        )  # fmt: skip


@dataclass(frozen=True)
class ObjectInfo:
    """A camera's description of one object (ISO 15740 clause 5.5.2), without its thumbnail and size
    in pixels, which are written as zero, and without dates."""

    storage: int
    format: int
    size_bytes: int
    name: str
    parent: int = 0

    def pack(self) -> bytes:
        """Bytes of the dataset. A size beyond 32 bits is written as 0xFFFFFFFF, as in PTP."""
        return b"".join(
            (
                struct.pack("<IHHI", self.storage, self.format, 0,
                            min(self.size_bytes, 0xFFFFFFFF)),
                struct.pack("<HIII", 0, 0, 0, 0),  # thumbnail
                struct.pack("<III", 0, 0, 0),  # image width, height, bit depth
                struct.pack("<IHII", self.parent, 0, 0, 0),  # association, sequence
                pack_string(self.name),
                pack_string("") * 3,  # when captured and modified, keywords
            )
        )  # fmt: skip


def pack_property_set(prop: int, value: int) -> bytes:
    """Data of `Operation.EOS_SET_DEVICE_PROP_VALUE_EX` for a property of one u32."""
    return struct.pack("<III", 12, prop, value)


def pack_property_bytes(prop: int, value: Buffer) -> bytes:
    """Data of `Operation.EOS_SET_DEVICE_PROP_VALUE_EX` for a property of a packed form."""
    return struct.pack("<II", 8 + len(value), prop) + bytes(value)


def parse_property_set(data: Buffer) -> tuple[int, bytes]:
    """Read the data of `Operation.EOS_SET_DEVICE_PROP_VALUE_EX`: property and value bytes.

    Raises WireError when the length it states is not that of `data`.
    """
    take = Reader(data, "property setting")
    stated, prop = take.u32(), take.u32()
    if stated != len(data):
        raise WireError(f"property setting: says {stated} bytes, has {len(data)}")
    return prop, bytes(take.take(take.left_bytes))


def pack_custom_functions(groups: Mapping[int, Mapping[int, int]]) -> bytes:
    """Value of `Property.CUSTOM_FUNCTIONS` from group -> function -> value; see the parser."""
    packed = b""
    for group, functions in groups.items():
        body = b"".join(struct.pack("<III", number, 1, at) for number, at in functions.items())
        packed += struct.pack("<III", group, 8 + len(body), len(functions)) + body
    return struct.pack("<II", 8 + len(packed), len(groups)) + packed


def parse_custom_functions(data: Buffer) -> dict[int, int]:
    """Read the value of `Property.CUSTOM_FUNCTIONS`: function number -> its (first) value.

    All u32: the length in bytes, the number of groups; for each group its number, its length from
    here on, its number of functions; for each function its number, how many values, the values.
    Raises WireError.
    """
    whole = Reader(data, "custom functions")
    stated = whole.u32()
    if stated < 4:
        raise WireError(f"custom functions: says {stated} bytes")
    take = Reader(whole.take(stated - 4), "custom functions")
    found: dict[int, int] = {}
    for _ in range(take.u32()):
        take.u32()
        take.u32()
        for _ in range(take.u32()):
            number, count = take.u32(), take.u32()
            values = Reader(take.take(4 * count), "custom functions")
            if count:
                found[number] = values.u32()
    return found
