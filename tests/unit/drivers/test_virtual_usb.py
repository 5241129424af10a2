"""The virtual camera's USB as libusb has it: claims, halts, resets, and transfers to the byte."""

from __future__ import annotations

import array
import errno
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import usb.core
import usb.util

from drivers.mock import MockDisplay, MockReadout, MockShutter
from drivers.virtual_camera import (
    CameraBody,
    FaultScript,
    PlainFilm,
    ScriptedFault,
    VirtualUsb,
)
from drivers.virtual_camera import make_bench_backend as bench_backend_of
from drivers.virtual_camera.model import BULB_BODY, CameraModel
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import CameraConfig
from pdcd.codes.make import make_codes
from pdcd.panels.schedule import build_frames
from pdcd.sensor.raw import read_raw
from tests import bench_rig
from tests.virtual_eos import Client, virtual_usb

IN, OUT, INTERRUPT = 0x81, 0x02, 0x83

KEEP_ON, INFO = 0x911D, 0x1001

PACKET = 512


class Bus:
    """A backend with a camera, opened and claimed."""

    def __init__(self, *faults: ScriptedFault, model: CameraModel = BULB_BODY) -> None:
        self.clock = VirtualClock()
        self.body = CameraBody(
            self.clock, PlainFilm(lambda _: b"raw"), model, FaultScript(wire=faults)
        )
        self.usb = VirtualUsb(self.body)
        self.handle: Any = self.open()
        self.usb.claim_interface(self.handle, 0)

    def open(self) -> Any:
        (device,) = self.usb.enumerate_devices()
        return self.usb.open_device(device)

    def write(self, data: bytes) -> int:
        return self.usb.bulk_write(self.handle, OUT, 0, array.array("B", data), 100)

    def command(self, code: int, *parameters: int, number: int = 0) -> None:
        size = 12 + 4 * len(parameters)
        head = struct.pack("<IHHI", size, 1, code, number)
        data = head + struct.pack(f"<{len(parameters)}I", *parameters)
        assert self.write(data) == len(data)

    def read(self, size: int = 4096) -> bytes:
        buffer = array.array("B", bytes(size))
        return buffer[: self.usb.bulk_read(self.handle, IN, 0, buffer, 100)].tobytes()

    def control(self, kind: int, request: int, data: bytes | int = b"", value: int = 0) -> bytes:
        buffer = array.array("B", bytes(data) if isinstance(data, int) else data)
        count = self.usb.ctrl_transfer(self.handle, kind, request, value, 0, buffer, 100)
        return buffer[:count].tobytes()

    def response(self, number: int = 0) -> int:
        length, kind, code, stated = struct.unpack_from("<IHHI", self.read())
        assert (kind, stated) == (3, number) and length >= 12
        return int(code)


def fails(number: int) -> Any:
    return pytest.raises(usb.core.USBError, match=f"Errno {number}")


def test_a_claim_is_for_one_and_ends_with_its_release() -> None:
    bus = Bus()
    other = bus.open()
    with fails(errno.EBUSY):
        bus.usb.claim_interface(other, 0)
    bus.usb.claim_interface(bus.handle, 0)  # its own again
    with fails(errno.ENOENT):
        bus.usb.release_interface(other, 0)
    bus.usb.release_interface(bus.handle, 0)
    with fails(errno.ENOENT):
        bus.usb.release_interface(bus.handle, 0)
    with fails(errno.EIO):
        bus.read()
    bus.usb.claim_interface(other, 0)
    bus.usb.close_device(bus.handle)  # which has claimed nothing
    with fails(errno.EBUSY):
        bus.usb.claim_interface(bus.handle, 0)
    bus.usb.close_device(other)
    bus.usb.claim_interface(bus.handle, 0)
    bus.usb.held_by_other = True
    with fails(errno.EBUSY):
        bus.usb.claim_interface(bus.handle, 0)


def test_a_reset_of_the_port_takes_session_answers_and_halts() -> None:
    bus = Bus(ScriptedFault("stall", KEEP_ON))
    for number, word in enumerate(((0x1002, 1), (KEEP_ON,))):
        bus.command(*word, number=number)
        if not number:
            assert bus.response() == 0x2001
    with fails(errno.EPIPE):
        bus.read()
    bus.usb.reset_device(bus.handle)
    assert not bus.body.session_open and bus.usb.address == 8
    bus.handle = bus.open()
    bus.usb.claim_interface(bus.handle, 0)
    assert bus.control(0xA1, 0x67, 64) == bytes.fromhex("0400 0120")
    with fails(errno.ETIMEDOUT):
        bus.read()
    bus.command(KEEP_ON)
    assert bus.response() == 0x2003


# Control requests.


def test_a_cancel_gives_up_the_answer_and_keeps_the_halt() -> None:
    bus = Bus(ScriptedFault("stall", INFO))
    bus.command(INFO)
    assert bus.control(0xA1, 0x67, 64) == bytes.fromhex("0800 1f20 81000000")
    assert bus.control(0xA1, 0x67, 4) == bytes.fromhex("0800 1f20")  # what fits
    assert len(bus.control(0x21, 0x64, b"\x01\x40" + bytes(4))) == 6
    with fails(errno.EPIPE):
        bus.read()
    bus.usb.clear_halt(bus.handle, OUT)
    with fails(errno.EPIPE):
        bus.read()
    bus.usb.clear_halt(bus.handle, IN)
    with fails(errno.ETIMEDOUT):
        bus.read()


# Transfers.


def test_a_transfer_is_read_in_pieces_of_whole_packets() -> None:
    wordy = replace(BULB_BODY.info, device_version="x" * 200)
    bus, info = Bus(model=replace(BULB_BODY, info=wordy)), wordy.pack()
    assert PACKET < 12 + len(info) < 2 * PACKET
    bus.command(INFO)
    first, rest = bus.read(PACKET), bus.read(PACKET)
    assert len(first) == PACKET and (first + rest)[12:] == info
    bus.response()
    bus.command(INFO)
    with fails(errno.EOVERFLOW):
        bus.read(PACKET + 1)  # the second packet does not fit, and is lost
    assert bus.response() == 0x2001
    bus.command(INFO)
    assert len(bus.read(12 + len(info))) == 12 + len(info)  # to the byte


def test_data_to_the_camera_may_come_in_pieces_behind_their_command() -> None:
    bus = Bus()
    bus.command(0x1002, 1)
    bus.response()
    setting = struct.pack("<3I", 12, 0xD103, 0x50)
    whole = struct.pack("<IHHI", 12 + len(setting), 2, 0x9110, 1) + setting
    for pieces in ((whole,), (whole[:12], whole[12:]), (whole[:20], whole[20:], b"")):
        bus.command(0x9110, number=1)
        with fails(errno.ETIMEDOUT):
            bus.read()  # it waits for them
        for piece in pieces:
            assert bus.write(piece) == len(piece)
        assert bus.response(1) == 0x2001 and bus.body.settings.iso == 200


def test_whole_packets_end_with_an_empty_one() -> None:
    """512 - 12 bytes of data make a transfer of one whole packet."""
    film = PlainFilm(lambda _: bytes(1000))
    client = Client(virtual_usb(film=film))
    client.ready()
    client.ok(0x9125)
    client.ok(0x9126)
    client.wait(1.0)
    ((handle, _, _),) = client.files()
    client.send(0x101B, handle, 0, 500)
    buffer = array.array("B", bytes(512))
    assert client.device.read(0x81, buffer, 100) == 512
    assert client.device.read(0x81, buffer, 100) == 0
    assert client.device.read(0x81, buffer, 100) == 16  # the response, with its parameter
    client.send(0x101B, handle, 0, 500)
    wide = array.array("B", bytes(1024))  # a buffer that is not full has seen the end
    assert client.device.read(0x81, wide, 100) == 512
    assert client.device.read(0x81, wide, 100) in (0, 16)


# On the mock bench


def test_it_photographs_the_bench_as_the_mock_camera_does(tmp_path: Path) -> None:
    """Same seed, same exposure: the samples of the two files are equal to the bit."""
    config = bench_rig.config(tmp_path, camera=CameraConfig(noise="full"))
    codes = make_codes("balanced", bench_rig.GRID, 8, dual="complement")
    frames = build_frames(
        bench_rig.pairs(codes), bench_rig.GRID, window="whole", schedule="full", passes=4
    )

    def contexts() -> tuple[DriverContext, MockDisplay]:
        context = DriverContext(config, VirtualClock())
        display = MockDisplay.create(context)
        display.connect()
        display.load(frames)
        return context, display

    context, display = contexts()
    shutter, readout = MockShutter.create(context), MockReadout.create(context)
    readout.arm(CameraSettings(iso=100, f_number=8.0))
    shutter.open()
    display.play(lambda *_: None, lambda: False)
    shutter.close()
    theirs = read_raw(readout.fetch(tmp_path, "mock", 60.0).path)

    context, display = contexts()
    client = Client(bench_backend_of(context))
    client.ready()
    assert client.set(0xD101, 0x38) == 0x2001  # f/8
    client.events()
    client.ok(0x9125)
    client.wait(config.trigger.lag_s + 4.0 * config.trigger.jitter_s)
    display.play(lambda *_: None, lambda: False)
    client.ok(0x9126)
    client.wait(1.0)
    ((handle, size, _),) = client.files()
    path = tmp_path / "virtual.dng"
    path.write_bytes(client.ok(0x1009, handle))
    assert path.stat().st_size == size
    ours = read_raw(path)
    np.testing.assert_array_equal(ours.planes, theirs.planes)
    assert ours.planes.std() > 10.0  # light and noise, not a black frame
    assert (ours.exposure_s, ours.f_number, ours.iso) == (theirs.exposure_s, 8.0, 100)


@pytest.mark.parametrize(
    ("begun", "nonsense"),
    [
        (INFO, b"\xff" * 40),
        (INFO, struct.pack("<IHHI", 12, 1, KEEP_ON, 0) + b"more"),
        (0x9110, struct.pack("<IHHI", 24, 3, 0x9110, 0) + bytes(12)),  # where data are due
    ],
)
def test_nonsense_halts_the_way_out_and_all_is_forgotten(begun: int, nonsense: bytes) -> None:
    bus = Bus()
    bus.command(begun)
    for data in (nonsense, b""):
        with fails(errno.EPIPE):
            bus.write(data)
    with fails(errno.ETIMEDOUT):
        bus.read()
    bus.usb.clear_halt(bus.handle, OUT)
    bus.command(0x1002, 1)
    assert bus.response() == 0x2001
