"""The virtual camera behaves as a 450D is known to, over real pyusb code."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

import pytest

from drivers.ptp.codes import ExposureMode
from drivers.virtual_camera import (
    BULB_BODY,
    CABLE_BODY,
    RELEASE_BODY,
    CameraModel,
    FaultScript,
)
from tests.virtual_eos import BULB, Client, raw_of, virtual_usb

Make = Callable[..., Client]

OK, GENERAL, NO_SESSION, UNSUPPORTED, BUSY, FULL = 0x2001, 0x2002, 0x2003, 0x2005, 0x2019, 0x200C


@pytest.fixture
def make() -> Iterator[Make]:
    clients = []

    def made(script: FaultScript | None = None, model: CameraModel = BULB_BODY) -> Client:
        clients.append(Client(virtual_usb(script, model)))
        return clients[-1]

    yield made
    for client in clients:
        client.close()


def bulb(client: Client, seconds: float) -> None:
    assert client.call(0x9125)[0] == OK
    client.wait(seconds)
    assert client.call(0x9126)[0] == OK


def listed(records: list[bytes], prop: int) -> tuple[int, ...]:
    """Values that an AvailListChanged record allows."""
    (found,) = (r for r in records if struct.unpack_from("<II", r, 4) == (0xC18A, prop))
    (count,) = struct.unpack_from("<I", found, 0x10)
    return struct.unpack_from(f"<{count}I", found, 0x14)


def test_the_property_list_comes_once_a_session(make: Make) -> None:
    client = make()
    first = client.start()
    assert listed(first, 0xD103) == (0x00, 0x48, 0x50, 0x58, 0x60, 0x68)  # no ISO 50
    assert listed(first, 0xD102)[0] == 0x0C
    assert listed(first, 0xD11C) == (2, 4)
    assert client.events() == []
    client.ok(0x9115, 0)
    client.ok(0x9115, 1)
    assert client.events() == []
    client.ok(0x1003)
    assert client.start() == first


def test_a_bulb_exposure_to_memory(make: Make) -> None:
    client = make()
    client.ready()
    bulb(client, 51.0)
    (exposure,) = client.body.shutter.exposures
    assert exposure.close_ns - exposure.open_ns == 51_000_000_000
    assert client.files() == []  # it takes a moment
    client.wait(0.2)
    ((handle, size, name),) = client.files()
    assert (size, name) == (3000, "IMG_0001.CR2")
    whole = b"".join(client.ok(0x101B, handle, at, 1024) for at in range(0, size, 1024))
    assert whole == raw_of(exposure) == client.ok(0x1009, handle)
    assert client.call(0x101B, handle, size, 1024)[1] == (0,)
    assert client.call(0x101B, handle, size + 1, 1)[0] == 0x201D
    client.ok(0x9117, handle)
    assert client.call(0x101B, handle, 0, 1024)[0] == 0x2009


def test_a_long_bulb_tells_its_seconds(make: Make) -> None:
    client = make()
    client.ready()
    client.ok(0x9125)
    client.wait(2.5)
    assert client.events() == [struct.pack("<III", 12, 0xC194, 2)]
    assert client.events() == []
    client.ok(0x9126)
    assert client.call(0x9126)[0] == GENERAL  # nothing is open


def test_memory_is_full_until_files_are_fetched(make: Make) -> None:
    client = make()
    client.ready()
    handles = []
    for _ in range(BULB_BODY.ram_shots):
        bulb(client, 0.5)
        client.wait(1.0)
        handles += [handle for handle, _, _ in client.files()]
        client.events()
    assert client.call(0x9125)[0] == FULL
    client.ok(0x9117, handles[0])
    client.events()
    assert client.call(0x9125)[0] == OK


def test_a_timed_release(make: Make) -> None:
    client = make()
    client.start()
    client.set(0xD102, 0x38)  # 1 s: five stops below 30 s
    client.events()
    assert client.call(0x910F)[:2] == (OK, (0,))
    client.wait(1.5)
    assert len(client.files()) == 1
    (exposure,) = client.body.shutter.exposures
    assert exposure.close_ns - exposure.open_ns == pytest.approx(30e9 / 32, rel=1e-9)


def test_bodies_that_hold_the_release_instead(make: Make) -> None:
    client = make(model=RELEASE_BODY)
    client.ready()
    assert client.call(0x9125)[0] == UNSUPPORTED
    assert client.call(0x9128, 1, 1)[0] == OK  # half a press opens nothing
    assert not client.body.shutter.is_open
    assert client.call(0x9128, 3, 1)[0] == OK
    assert client.body.shutter.is_open
    client.ok(0x9129, 1)
    assert client.body.shutter.is_open
    client.ok(0x9129, 3)
    assert not client.body.shutter.is_open


def test_a_cable_release_needs_no_computer(make: Make) -> None:
    client = make(model=CABLE_BODY)
    client.ready()
    assert client.call(0x9125)[0] == client.call(0x9128, 3, 1)[0] == UNSUPPORTED
    client.body.press()
    client.wait(2.0)
    client.body.release()
    client.body.release()
    client.wait(0.2)
    assert len(client.files()) == 1
    (exposure,) = client.body.shutter.exposures
    assert exposure.close_ns - exposure.open_ns == 2_000_000_000


def test_the_dial_off_m_offers_no_speeds_and_a_low_battery_speaks_up(make: Make) -> None:
    client = make(FaultScript(dial=ExposureMode.APERTURE_PRIORITY, battery=0))
    first = client.start()
    assert listed(first, 0xD102) == ()
    assert client.set(*BULB) == 0x201C
    assert struct.pack("<4I", 16, 0xC189, 0xD105, 2) in first
    assert struct.pack("<III", 12, 0xC18D, 0) in first


def test_noise_reduction_doubles_the_time(make: Make) -> None:
    client = make(FaultScript(long_exposure_nr=True))
    first = client.start()
    nr = struct.pack("<III", 0x201, 1, 2)
    assert any(nr in r for r in first if struct.unpack_from("<II", r, 4) == (0xC189, 0xD1A0))
    client.set(*BULB)
    client.events()
    bulb(client, 10.0)
    client.wait(9.0)
    assert client.files() == []
    assert client.call(0x9125)[0] == BUSY
    client.wait(1.3)
    assert len(client.files()) == 1
