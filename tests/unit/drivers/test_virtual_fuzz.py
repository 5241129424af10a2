"""Whatever a client sends, the virtual camera answers, or fails as a camera on the USB does."""

from __future__ import annotations

import struct

import usb.core
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ptp.containers import Message, parse_message
from drivers.virtual_camera import RELEASE_BODY, CameraBody, PlainFilm
from drivers.virtual_camera.reply import CameraReply
from pdcd.bench.clock import VirtualClock
from tests.virtual_eos import Client, raw_of, virtual_usb

CODES = st.sampled_from(sorted({*RELEASE_BODY.info.operations, 0x9125, 0x9126}))
U32 = st.one_of(st.integers(0, 8), st.integers(0, 2**32 - 1), st.just(0x91900011))
CALLS = st.lists(
    st.tuples(CODES, st.lists(U32, max_size=5), st.binary(max_size=24)), min_size=1, max_size=12
)
fuzz = settings(max_examples=150, database=None)


@fuzz
@given(CALLS)
def test_any_operations_in_any_order(calls: list[tuple[int, list[int], bytes]]) -> None:
    body = CameraBody(VirtualClock(), PlainFilm(raw_of))
    for code, parameters, data in [(0x1002, [1], b""), (0x9114, [1], b""), *calls]:
        reply = body.transact(code, tuple(parameters), data)
        assert isinstance(reply, CameraReply)
        assert 0x2001 <= reply.code <= 0x20FF
        assert reply.fault is None
    assert body.shutter.opened <= len(calls)


@fuzz
@given(st.lists(st.binary(min_size=1, max_size=80), min_size=1, max_size=6))
def test_any_bytes_on_the_usb(writes: list[bytes]) -> None:
    client = Client(virtual_usb())
    try:
        for data in writes:
            try:
                client.device.write(2, data, 10)
            except usb.core.USBError:
                client.device.clear_halt(2)
        client.device.ctrl_transfer(0x21, 0x66, 0, 0, b"")  # and a reset makes it sound again
        client.transaction = -1
        assert client.start()
    finally:
        client.close()


def test_an_answer_is_a_response_by_its_own_bytes() -> None:
    """Codec and a struct string of its own agree on what the camera sent."""
    client = Client(virtual_usb())
    client.send(0x911D)
    answer = client.read()
    assert struct.unpack("<IHHI", answer) == (12, 3, 0x2003, 0)
    assert isinstance(parse_message(answer)[0], Message)
