"""The PTP wire format against bytes put together by hand from the published layout."""

from __future__ import annotations

import os
import struct

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.ptp.codes import (
    CUSTOM_LONG_EXPOSURE_NR,
    ContainerType,
    EosEvent,
    Operation,
    Property,
)
from drivers.ptp.containers import (
    Header,
    Message,
    WireError,
    pack_data_header,
    pack_message,
    parse_header,
    parse_message,
)
from drivers.ptp.datasets import (
    DeviceInfo,
    ObjectInfo,
    Reader,
    pack_custom_functions,
    pack_property_bytes,
    pack_property_set,
    pack_string,
    pack_u16s,
    pack_u32s,
    parse_custom_functions,
    parse_property_set,
)
from drivers.ptp.events import (
    AvailList,
    EosRecord,
    ObjectAdded,
    PlainRecord,
    PropValue,
    is_raw_only,
    pack_events,
    parse_events,
)
from pdcd.errors import DecodeError

CASES = int(os.environ.get("PDCD_FUZZ_CASES", "300"))
"""Fuzzed cases a test; the 100,000 of a release are asked for by the environment."""

fuzz = settings(
    max_examples=CASES,
    database=None,
)

OPEN_SESSION = bytes.fromhex("10000000 0100 0210 00000000 01000000")

OK_OF_7 = bytes.fromhex("0c000000 0300 0120 07000000")

END = bytes.fromhex("08000000 00000000")


# Containers


def test_a_command_is_laid_out_as_the_standard_says() -> None:
    made = pack_message(ContainerType.COMMAND, Operation.OPEN_SESSION, 0, (1,))
    assert made == OPEN_SESSION
    assert parse_message(OPEN_SESSION) == (Message(ContainerType.COMMAND, 0x1002, 0, (1,)), 16)


def test_bytes_behind_a_response_are_left_to_the_caller() -> None:
    message, taken = parse_message(OK_OF_7 + OPEN_SESSION)
    assert message == Message(ContainerType.RESPONSE, 0x2001, 7)
    assert taken == 12


def test_a_data_header_counts_itself_and_may_leave_the_length_open() -> None:
    assert pack_data_header(0x9116, 5, 8) == bytes.fromhex("14000000 0200 1691 05000000")
    open_ended = bytes.fromhex("ffffffff 0200 0910 05000000")
    assert pack_data_header(0x1009, 5, 2**32) == open_ended
    assert parse_header(open_ended) == Header(None, ContainerType.DATA, 0x1009, 5)
    assert parse_header(open_ended).payload_bytes is None
    assert parse_header(pack_data_header(0x1009, 5, 3)).payload_bytes == 3


@pytest.mark.parametrize(
    "damaged",
    [
        b"",
        OPEN_SESSION[:11],  # no whole header
        OPEN_SESSION[:15],  # a parameter cut off
        bytes.fromhex("0b000000 0300 0120 07000000"),  # shorter than its header
        bytes.fromhex("0e000000 0300 0120 07000000 0000"),  # half a parameter
        bytes.fromhex("24000000 0300 0120 07000000") + bytes(24),  # six parameters
        bytes.fromhex("0c000000 0500 0120 07000000"),  # unknown type
        bytes.fromhex("0c000000 0200 0910 07000000"),  # data, where a message is due
        bytes.fromhex("ffffffff 0300 0120 07000000"),  # a response cannot leave its length open
    ],
)
def test_damaged_messages_are_refused(damaged: bytes) -> None:
    with pytest.raises(WireError, match="camera"):
        parse_message(damaged)
    assert issubclass(WireError, DecodeError)


# Datasets


def test_strings_count_units_and_end_with_zero() -> None:
    assert pack_string("Canon") == bytes.fromhex("06 4300 6100 6e00 6f00 6e00 0000")
    assert pack_string("") == b"\0"
    assert Reader(bytes.fromhex("06 4300 6100 6e00 6f00 6e00 0000"), "x").string() == "Canon"
    # Canon pads strings: what lies behind the zero is no part of them.
    assert Reader(bytes.fromhex("04 4100 0000 ff00 ff00"), "x").string() == "A"
    with pytest.raises(WireError, match="UTF-16"):
        Reader(bytes.fromhex("02 00d8 0000"), "x").string()  # half of a surrogate pair
    with pytest.raises(ValueError, match="254"):
        pack_string("a" * 255)


def test_arrays_are_counted_in_32_bits() -> None:
    assert pack_u16s([0x9125, 0x9126]) == bytes.fromhex("02000000 2591 2691")
    assert pack_u32s([7]) == bytes.fromhex("01000000 07000000")
    assert Reader(bytes.fromhex("02000000 2591 2691"), "x").array_u16() == (0x9125, 0x9126)


def test_a_count_beyond_the_data_allocates_nothing() -> None:
    for data in (b"\xff\xff\xff\xff", b"\xff\xff\xff\xff" + bytes(100)):
        with pytest.raises(WireError, match="are there"):
            Reader(data, "x").array_u16()


DEVICE_INFO = b"".join(
    (
        bytes.fromhex("6400 0b000000 c800"),  # standard 1.00, Canon, extension 2.00
        bytes.fromhex("00"),  # no extension text
        bytes.fromhex("0000"),  # functional mode
        bytes.fromhex("02000000 2591 2691"),  # operations
        bytes.fromhex("01000000 01c1"),  # events
        bytes.fromhex("01000000 02d4"),  # properties
        bytes.fromhex("01000000 0138"),  # capture formats
        bytes.fromhex("02000000 01b1 03b1"),  # image formats
        bytes.fromhex("03 4300 6900 0000"),  # manufacturer "Ci"
        bytes.fromhex("03 3400 4400 0000"),  # model "4D"
        bytes.fromhex("02 3300 0000"),  # version "3"
        bytes.fromhex("02 7800 0000"),  # serial "x"
    )
)


def test_device_info_is_laid_out_as_the_standard_says() -> None:
    info = DeviceInfo.parse(DEVICE_INFO)
    assert (info.manufacturer, info.model, info.device_version, info.serial) == (
        "Ci",
        "4D",
        "3",
        "x",
    )
    assert info.operations == (0x9125, 0x9126)
    assert (info.events, info.properties) == ((0xC101,), (0xD402,))
    assert (info.capture_formats, info.image_formats) == ((0x3801,), (0xB101, 0xB103))
    assert (info.vendor_extension_id, info.vendor_extension_version) == (0xB, 200)
    assert info.supports(Operation.EOS_BULB_START, Operation.EOS_BULB_END)
    assert not info.supports(Operation.EOS_BULB_START, Operation.EOS_REMOTE_RELEASE_ON)
    assert info.pack() == DEVICE_INFO


OBJECT_INFO = b"".join(
    (
        bytes.fromhex("01000200 03b1 0000 34120000"),  # storage, CR2, protection, 0x1234 bytes
        bytes.fromhex("0000 00000000 00000000 00000000"),  # thumbnail
        bytes.fromhex("00000000 00000000 00000000"),  # size in pixels
        bytes.fromhex("09000000 0000 00000000 00000000"),  # parent, association, sequence
        bytes.fromhex("03 6100 6200 0000"),  # "ab"
        bytes(3),  # dates, keywords
    )
)


def test_object_info_is_laid_out_as_the_standard_says() -> None:
    info = ObjectInfo(0x20001, 0xB103, 0x1234, "ab", parent=9)
    assert info.pack() == OBJECT_INFO


def test_a_property_is_set_by_length_number_value() -> None:
    bulb = bytes.fromhex("0c000000 02d10000 0c000000")
    assert pack_property_set(Property.SHUTTER_SPEED, 0x0C) == bulb
    assert parse_property_set(bulb) == (0xD102, bytes.fromhex("0c000000"))
    assert pack_property_bytes(0xD120, b"\1\2") == bytes.fromhex("0a000000 20d10000 0102")
    for damaged in (bulb[:11], bulb + b"\0", b"\0" * 7):
        with pytest.raises(WireError):
            parse_property_set(damaged)


# EOS records, byte for byte at the offsets that real bodies use

RAM_OBJECT = bytes.fromhex(
    "28000000 86c10000"  # 00 size, 04 code
    "11223344"  # 08 handle
    "03b10000 00000000"  # 0C format
    "785634 12"  # 14 size
    "00000000"  # 18
    "494d47 5f303030312e4352 3200"  # 1C name
)

CARD_OBJECT = bytes.fromhex(
    "34000000 81c10000"
    "11223344"  # 08 handle
    "01000200"  # 0C storage
    "03b10000 00000000 00000000"  # 10 format
    "78563412"  # 1C size
    "0000c041"  # 20 parent
    "00000000"  # 24
    "494d475f303030312e43523200"  # 28 name
)


def _sized(record: bytes) -> bytes:
    """The record padded to whole words, with its true size in front."""
    record += b"\0" * (-len(record) % 4)
    return struct.pack("<I", len(record)) + record[4:]


def test_a_property_and_its_list() -> None:
    value = bytes.fromhex("10000000 89c10000 03d10000 48000000")
    listed = bytes.fromhex("1c000000 8ac10000 03d10000 03000000 02000000 48000000 50000000")
    iso, isos = parse_events(value + listed + END)
    assert iso == PropValue.of(0xD103, 0x48)
    assert isinstance(iso, PropValue)
    assert iso.value == 0x48
    assert isos == AvailList(0xD103, (0x48, 0x50))
    assert pack_events([iso, isos]) == value + listed + END


def test_image_formats_come_in_pieces() -> None:
    raw = struct.pack("<5I", 1, 0x10, 6, 0, 4)
    both = struct.pack("<9I", 2, 0x10, 6, 0, 4, 0x10, 1, 0, 3)
    head = struct.pack("<5I", 20 + len(raw + both), 0xC18A, 0xD120, 3, 2)
    (found,) = parse_events(head + raw + both + END)
    assert found == AvailList(0xD120, (), (raw, both))
    assert pack_events([found]) == head + raw + both + END
    for entries in (0, 3):
        record = struct.pack("<6I", 24, 0xC18A, 0xD120, 3, 1, entries)
        with pytest.raises(WireError, match=f"an entry of {entries} files"):
            parse_events(record + END)


def test_unknown_records_are_kept_and_the_end_may_be_missing() -> None:
    strange = bytes.fromhex("0a000000 99c10000 beef")
    seconds = bytes.fromhex("0c000000 94c10000 05000000")
    assert parse_events(strange + seconds) == [
        PlainRecord(0xC199, b"\xbe\xef"),
        PlainRecord(EosEvent.BULB_EXPOSURE_TIME, bytes.fromhex("05000000")),
    ]
    assert parse_events(b"") == []
    assert parse_events(END) == []
    # An odd kind of list is not guessed at.
    other = struct.pack("<6I", 24, 0xC18A, 0xD1B0, 7, 1, 9)
    assert parse_events(other) == [PlainRecord(0xC18A, other[8:])]


@pytest.mark.parametrize(
    "damaged",
    [
        bytes.fromhex("07000000 89c10000"),  # smaller than its own head
        bytes.fromhex("00000000 89c10000"),  # would never end
        bytes.fromhex("10000000 89c10000 03d10000"),  # beyond the data
        bytes.fromhex("0a000000 89c10000 0000"),  # too small for a property
        bytes.fromhex("10000000 86c10000 11223344 03b10000"),  # too small for a file
        bytes.fromhex("18000000 8ac10000 03d10000 03000000 ffffff7f 48000000"),  # count too high
        bytes.fromhex("89c1"),
    ],
)
def test_damaged_records_are_refused(damaged: bytes) -> None:
    with pytest.raises(WireError):
        parse_events(damaged)


def test_a_short_value_is_refused_when_it_is_asked_for() -> None:
    with pytest.raises(WireError, match="D103"):
        _ = PropValue(0xD103, b"\x48\x00").value


# Fuzzing: whatever the bytes, a value or a WireError

ANY = st.binary(max_size=160)

U32 = st.integers(0, 2**32 - 1)

TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=60)


@st.composite
def _damaged(draw: st.DrawFn, whole: bytes) -> bytes:
    """Take a sound message, change a few bytes, and cut it or lengthen it."""
    data = bytearray(whole)
    for _ in range(draw(st.integers(0, 4))):
        data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    cut = draw(st.integers(0, len(data)))
    return bytes(data[:cut]) + draw(st.binary(max_size=12))


EVENTS = pack_events(
    [
        PropValue.of(0xD103, 0x48),
        AvailList(0xD103, (0x48, 0x50, 0x58)),
        AvailList(0xD120, (), (struct.pack("<5I", 1, 0x10, 6, 0, 4),)),
        ObjectAdded(1, 0xB103, 99, "IMG_0001.CR2", True),
        ObjectAdded(1, 0xB103, 99, "IMG_0001.CR2", False),
    ]
)


@fuzz
@given(st.one_of(ANY, _damaged(OPEN_SESSION), _damaged(OK_OF_7)))
@example(b"\xff" * 64)
def test_fuzzed_containers(data: bytes) -> None:
    for parse in (parse_header, parse_message):
        try:
            parse(data)
        except WireError:
            continue


@fuzz
@given(st.one_of(ANY, _damaged(EVENTS)))
@example(b"\xff" * 64)
def test_fuzzed_events(data: bytes) -> None:
    try:
        records = parse_events(data)
    except WireError:
        return
    for record in records:
        if isinstance(record, PropValue) and len(record.data) >= 4:
            assert 0 <= record.value < 2**32
        if isinstance(record, AvailList):
            assert len(record.values) <= len(data) / 4


@fuzz
@given(st.one_of(ANY, _damaged(DEVICE_INFO)))
@example(b"\xff" * 64)
def test_fuzzed_datasets(data: bytes) -> None:
    for parse in (
        DeviceInfo.parse,
        parse_property_set,
        parse_custom_functions,
        is_raw_only,
    ):
        try:
            parse(data)
        except WireError:
            continue


@fuzz
@given(TEXT.filter(lambda text: len(text.encode("utf-16-le")) <= 508), st.lists(U32, max_size=9))
def test_what_is_packed_comes_back(text: str, numbers: list[int]) -> None:
    assert Reader(pack_string(text), "x").string() == text
    records: list[EosRecord] = [AvailList(0xD103, tuple(numbers))]
    records += [PropValue.of(0xD101, n) for n in numbers]
    assert parse_events(pack_events(records)) == records
    message = Message(ContainerType.EVENT, 0xC101, 3, tuple(numbers[:5]))
    packed = pack_message(message.kind, message.code, message.transaction, message.parameters)
    assert parse_message(packed) == (message, len(packed))


@pytest.mark.parametrize(
    ("kinds", "raw"), [((6,), True), ((1,), False), ((6, 1), False), ((6, 6), False), ((), False)]
)
def test_raw_alone_is_raw(kinds: tuple[int, ...], raw: bool) -> None:
    packed = struct.pack("<I", len(kinds))
    packed += b"".join(struct.pack("<4I", 16, kind, 0, 4) for kind in kinds)
    assert is_raw_only(packed) is raw


def test_custom_functions_of_no_two_or_damaged_groups() -> None:
    # One value of u32 a function; a group's length counts from its own field on.
    whole = struct.pack(
        "<18I", 72, 2,
        1, 20, 1, 0x101, 1, 0,
        2, 36, 2, 0x201, 1, 2, 0x203, 2, 5, 6,
    )  # fmt: skip
    assert parse_custom_functions(whole) == {0x101: 0, CUSTOM_LONG_EXPOSURE_NR: 2, 0x203: 5}
    assert parse_custom_functions(struct.pack("<II", 8, 0)) == {}
    without_value = struct.pack("<7I", 28, 1, 1, 16, 1, 0x201, 0)
    assert parse_custom_functions(without_value) == {}
    for damaged in (whole[:-4], struct.pack("<I", 3), struct.pack("<I", 4)):
        with pytest.raises(WireError):
            parse_custom_functions(damaged)
    assert pack_custom_functions({1: {0x101: 0}}) == struct.pack(
        "<8I", 32, 1, 1, 20, 1, 0x101, 1, 0
    )


def test_a_size_that_does_not_fit_is_left_open_or_told_as_the_largest() -> None:
    lengths = [
        struct.unpack_from("<I", pack_data_header(0x1009, 1, payload_bytes))[0]
        for payload_bytes in (0xFFFFFFFF - 13, 0xFFFFFFFF - 12, 1 << 40)
    ]
    assert lengths == [0xFFFFFFFE, 0xFFFFFFFF, 0xFFFFFFFF]
    assert ObjectInfo(1, 2, 1 << 33, "a").pack() == ObjectInfo(1, 2, 0xFFFFFFFF, "a").pack()


@pytest.mark.parametrize("on_card", [True, False])
def test_a_file_in_memory_or_on_the_card(on_card: bool) -> None:
    record = _sized(CARD_OBJECT if on_card else RAM_OBJECT)
    where = {"storage": 0x20001, "parent": 0x41C00000} if on_card else {}
    added = ObjectAdded(0x44332211, 0xB103, 0x12345678, "IMG_0001.CR2", on_card, **where)
    assert parse_events(record + END) == [added]
    assert added.pack() == record
