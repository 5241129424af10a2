"""The virtual camera's USB: errors, packets and speed as libusb has them."""

from __future__ import annotations

import array
import errno
import hashlib
from pathlib import Path

import numpy as np
import pytest
import usb.core
import usb.util

from drivers.mock import MockDisplay, MockReadout, MockShutter
from drivers.virtual_camera import BenchFilm, FaultScript, PlainFilm, ScriptedFault
from drivers.virtual_camera import make_bench_backend as bench_backend_of
from drivers.virtual_camera.faults import WireKind
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import CameraConfig
from pdcd.codes.make import make_codes
from pdcd.panels.schedule import build_frames
from pdcd.sensor.raw import read_raw
from tests import bench_rig
from tests.virtual_eos import Client, virtual_usb

KEEP_ON = 0x911D


def faulty(*faults: ScriptedFault) -> Client:
    client = Client(virtual_usb(FaultScript(wire=faults)))
    client.start()
    return client


def test_a_stall_is_over_when_the_halt_is_cleared() -> None:
    client = faulty(ScriptedFault("stall", KEEP_ON))
    client.send(KEEP_ON)
    for _ in range(2):
        with pytest.raises(usb.core.USBError) as caught:
            client.read()
        assert caught.value.errno == errno.EPIPE
    status = client.device.ctrl_transfer(0xA1, 0x67, 0, 0, 64).tobytes()
    assert status == bytes.fromhex("0800 1f20 81000000")  # cancelled, and which endpoint halts
    client.device.clear_halt(0x81)
    assert client.answer()[0] == 0x2001
    assert client.device.ctrl_transfer(0xA1, 0x67, 0, 0, 64).tobytes() == bytes.fromhex("0400 0120")


@pytest.mark.parametrize(("kind", "done"), [("mute", 1), ("deaf", 0)])
def test_no_answer_is_a_timeout_of_the_clock(kind: WireKind, done: int) -> None:
    client = faulty(ScriptedFault(kind, KEEP_ON))
    before = client.body.clock.now_ns()
    client.send(KEEP_ON)
    with pytest.raises(usb.core.USBTimeoutError) as caught:
        client.read()
    assert caught.value.errno == errno.ETIMEDOUT
    assert client.body.clock.now_ns() - before == 1_000_000_000
    assert client.body.kept_on == done
    client.device.ctrl_transfer(0x21, 0x64, 0, 0, b"\x01\x40\x04\0\0\0")  # cancel
    assert client.call(KEEP_ON)[0] == 0x2001


def test_a_device_reset_takes_the_session() -> None:
    client = faulty()
    client.device.ctrl_transfer(0x21, 0x66, 0, 0, b"")
    assert client.call(KEEP_ON)[0] == 0x2003
    assert client.start()


def test_a_port_reset_moves_the_camera() -> None:
    backend = virtual_usb()
    client = Client(backend)
    client.start()
    client.device.reset()
    with pytest.raises(usb.core.USBError) as caught:
        client.ok(KEEP_ON)
    assert caught.value.errno in (errno.ENODEV, errno.EIO)
    again = Client(backend)
    assert again.device.address != client.device.address
    assert again.start()


def test_an_unplugged_camera_is_gone_and_comes_back_without_a_session() -> None:
    backend = virtual_usb(FaultScript(wire=(ScriptedFault("unplug", 0x9126),)))
    client = Client(backend)
    client.ready()
    client.ok(0x9125)
    for _ in range(2):
        with pytest.raises(usb.core.USBError) as caught:
            client.send(0x9126)
        assert caught.value.errno == errno.ENODEV
    assert usb.core.find(backend=backend) is None
    assert backend.body.shutter.is_open  # nobody told it to close
    backend.body.replug()
    again = Client(backend)
    assert again.call(KEEP_ON)[0] == 0x2003
    again.start()
    again.ok(0x9126)
    assert backend.body.shutter.opened == 1


def test_a_busy_interface_cannot_be_claimed() -> None:
    backend = virtual_usb()
    backend.held_by_other = True
    with pytest.raises(usb.core.USBError) as caught:
        Client(backend)
    assert caught.value.errno == errno.EBUSY
    backend.held_by_other = False
    first = Client(backend)
    with pytest.raises(usb.core.USBError, match="busy"):
        Client(backend)
    first.close()
    Client(backend).close()


def test_an_unclaimed_interface_moves_no_bytes() -> None:
    client = Client(virtual_usb())
    usb.util.release_interface(client.device, 0)
    with pytest.raises(usb.core.USBError):
        client.device.read(0x81, 512)


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


def test_a_buffer_smaller_than_a_packet_overflows() -> None:
    client = faulty()
    client.send(0x9108)
    with pytest.raises(usb.core.USBError) as caught:
        client.device.read(0x81, array.array("B", bytes(20)), 100)
    assert caught.value.errno == errno.EOVERFLOW


def test_nonsense_halts_the_endpoint() -> None:
    client = faulty()
    with pytest.raises(usb.core.USBError) as caught:
        client.device.write(2, b"\xff" * 40, 100)
    assert caught.value.errno == errno.EPIPE
    client.device.clear_halt(2)
    assert client.call(KEEP_ON)[0] == 0x2001


def test_24_mb_come_identical() -> None:
    raw = np.random.default_rng(0).integers(0, 256, 24_300_000, dtype=np.uint8).tobytes()
    client = Client(virtual_usb(film=PlainFilm(lambda _: raw)))
    client.ready()
    client.ok(0x9125)
    client.ok(0x9126)
    client.wait(1.0)
    ((handle, size, _),) = client.files()
    block = 1 << 20
    buffer = array.array("B", bytes(block + 512))
    view = memoryview(buffer)
    whole = memoryview(bytearray(size))

    for at in range(0, size, block):
        due = min(block, size - at)
        client.send(0x101B, handle, at, due)
        assert client.device.read(0x81, buffer, 1000) == 12 + due
        whole[at : at + due] = view[12 : 12 + due]
        while client.device.read(0x81, buffer, 1000) == 0:
            pass
    assert hashlib.sha256(whole).digest() == hashlib.sha256(raw).digest()


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


def test_a_bench_offers_what_its_sensor_and_lens_have(tmp_path: Path) -> None:
    config = bench_rig.config(tmp_path)
    film = BenchFilm(DriverContext(config, VirtualClock()))
    settings = bench_backend_of(DriverContext(config, VirtualClock())).body.settings
    assert set(settings.lists[0xD103]) <= {0x00, 0x48, 0x50, 0x58, 0x60, 0x68}
    assert 100 in film.isos
    assert 0x38 in settings.lists[0xD101]
