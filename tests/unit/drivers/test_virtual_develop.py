"""A file that takes long to make holds no answer of the virtual camera up."""

from __future__ import annotations

import itertools
import struct
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field

import pytest

from drivers.virtual_camera import CameraExposure, PlainFilm
from drivers.virtual_camera import command as command_module
from drivers.virtual_camera.develop import Develop, start_developer
from drivers.virtual_camera.ptpip import PtpIpServer
from tests.unit.drivers.test_virtual_ptpip import Line
from tests.virtual_eos import Client, raw_of, virtual_usb

OK, BUSY = 0x2001, 0x2019

BULB_START, BULB_END, GET_EVENT, GET_OBJECT = 0x9125, 0x9126, 0x9116, 0x1009

PATIENCE_S = 20.0


@dataclass
class Slow:
    """Makes a file once it is let."""

    let: threading.Event = field(default_factory=threading.Event)
    last: Future[bytes] | None = None
    faulty: bool = False

    def raw(self, exposure: CameraExposure) -> bytes:
        assert self.let.wait(PATIENCE_S)
        if self.faulty:
            raise MemoryError("no room for it")
        return raw_of(exposure)

    def watched(self, develop: Develop) -> Develop:
        """The same, but for a look at what it is making."""

        def watch(make: object) -> Future[bytes]:
            self.last = develop(make)  # type: ignore[arg-type]
            return self.last

        return watch

    def made(self) -> None:
        """Let the file be made, and wait for it."""
        self.let.set()
        assert self.last is not None
        self.last.exception(PATIENCE_S)


@pytest.fixture
def slow() -> Iterator[Slow]:
    made = Slow()
    yield made
    made.let.set()


@pytest.fixture
def client(slow: Slow) -> Iterator[Client]:
    with start_developer() as develop:
        backend = virtual_usb(film=PlainFilm(slow.raw), develop=slow.watched(develop))
        made = Client(backend)
        made.ready()
        yield made
        made.close()
        slow.let.set()


def bulb(client: Client) -> None:
    client.ok(BULB_START)
    client.wait(1.0)
    client.ok(BULB_END)
    client.wait(60.0)  # far beyond the time in which a file is due


def test_the_file_is_announced_when_it_is_made_and_not_before(client: Client, slow: Slow) -> None:
    bulb(client)  # answered, though no file is made
    assert client.files() == []
    assert client.call(BULB_START)[0] == BUSY  # its file is still under way
    slow.made()
    ((handle, size, name),) = client.files()
    assert name == "IMG_0001.CR2"
    (exposure,) = client.body.shutter.exposures
    assert client.ok(GET_OBJECT, handle) == raw_of(exposure) and size == 3000
    assert client.files() == []


def test_a_file_that_cannot_be_made_never_comes_and_the_camera_goes_on(
    client: Client, slow: Slow, caplog: pytest.LogCaptureFixture
) -> None:
    slow.faulty = True
    bulb(client)
    slow.made()
    assert client.files() == []
    (said,) = [r.getMessage() for r in caplog.records if r.levelname == "ERROR"]
    assert "MemoryError: no room for it" in said
    slow.faulty = False
    bulb(client)
    slow.made()
    assert len(client.files()) == 1


def test_clients_on_the_network_are_answered_while_a_file_is_made(slow: Slow) -> None:
    """libgphoto2 waits for an answer for 2.5 s, and takes the camera for broken then."""
    with start_developer() as develop:
        body = command_module.make_real_time_body(PlainFilm(slow.raw), slow.watched(develop))
        with PtpIpServer(body, 0) as server:
            line = Line(server)
            line.open()
            numbers = itertools.count(1)

            def answered(code: int, *parameters: int) -> int:
                line.operate(code, next(numbers), *parameters)
                return line.response()[0]

            assert answered(0x9114, 1) == OK
            body.settings.put(0xD102, struct.pack("<I", 0x0C))
            assert answered(BULB_START) == OK
            assert answered(BULB_END) == OK  # not let yet: the answer did not wait for the file
            assert not slow.let.is_set() and not body.store.files
            slow.made()
            line.socket.close()
