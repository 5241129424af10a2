"""A machine-vision camera for tests: Aravis' simulator, hosted or stock, one at a time.

There is one address and one port for all processes of the tests, so whoever wants it waits for it.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.genicam.camera import GenicamCamera
from drivers.genicam.library import load_library
from drivers.genicam.options import GenicamOptions
from drivers.genicam.pixels import BY_NAME
from drivers.virtual_genicam.camera import VirtualExposure, VirtualGenicamCamera
from drivers.virtual_genicam.description import CameraDescription
from drivers.virtual_genicam.simulator import VIRTUAL_ADDRESS
from pdcd.bench.clock import VirtualClock
from pdcd.driver import CameraSettings, Clock, PhotoFrame
from tests.plain_film import PlainFilm
from tests.tools import needs, program

_TURN_S = 150.0
_CLONE_NEWNET, _SIOCSIFFLAGS, _IFF_UP = 0x40000000, 0x8914, 1
_DARK_S = 1e-3
BLACK_DN = 40

SETTINGS = CameraSettings(iso=100, f_number=None, exposure_s=0.02)


def has_aravis() -> bool:
    """Whether the library is on this machine."""
    try:
        load_library()
    except ModuleNotFoundError:
        return False
    return True


needs_aravis = pytest.mark.skipif(not has_aravis(), reason="no libaravis-0.8 here")
needs_stock = needs("arv-fake-gv-camera")


@contextlib.contextmanager
def turn() -> Iterator[None]:
    """The address of the simulator, for one test of all processes.

    Where the kernel lets us (root), in a network of the test's own, for which nobody waits: this
    thread's, and that of every thread and process begun by it.
    """
    with own_network(), socket.socket(socket.AF_UNIX) as lock:
        for _ in range(round(_TURN_S / 0.05)):
            try:
                lock.bind("\0pdcd tests: virtual GenICam")  # of this name a network has one
                break
            except OSError:
                time.sleep(0.05)
        else:
            pytest.fail("another test has kept the address of the simulator")
        yield


@contextlib.contextmanager
def own_network() -> Iterator[bool]:
    """A network with nothing but a loopback; False, and that of all, where there may be none."""
    libc = ctypes.CDLL(None, use_errno=True)
    with Path("/proc/thread-self/ns/net").open() as before:
        if libc.unshare(_CLONE_NEWNET):
            yield False
            return
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
                fcntl.ioctl(any_socket, _SIOCSIFFLAGS, struct.pack("16sh14x", b"lo", _IFF_UP))
            yield True
        finally:
            assert not libc.setns(before.fileno(), _CLONE_NEWNET)


class Sheets:
    """A film of random samples, the last of which are remembered; short exposures are black."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self.exposures: list[VirtualExposure] = []
        self.last: NDArray[np.uint16] = np.zeros((0, 0), np.uint16)

    def __call__(self, exposure: VirtualExposure) -> NDArray[np.uint16]:
        self.exposures.append(exposure)
        shape = (exposure.height, exposure.width)
        if exposure.exposure_s < _DARK_S:
            return self._rng.integers(BLACK_DN - 3, BLACK_DN + 4, shape).astype(np.uint16)
        high = 1 << exposure.pixel_format.bits
        self.last = self._rng.integers(0, high, shape).astype(np.uint16)
        return self.last


@contextlib.contextmanager
def hosted(
    *formats: str,
    film: Callable[[VirtualExposure], NDArray[np.uint16]],
    size: tuple[int, int] = (64, 48),
    clock: Clock | None = None,
    white: int | None = None,
    longest_s: float = 60.0,
) -> Iterator[VirtualGenicamCamera]:
    """A camera of these formats that is there."""
    known = tuple(BY_NAME[name] for name in formats)
    description = CameraDescription(*size, known, white=white, longest_s=longest_s)
    virtual = VirtualGenicamCamera(description, PlainFilm(film), clock or VirtualClock())
    with turn():
        virtual.start()
        try:
            yield virtual
        finally:
            virtual.stop()


@contextlib.contextmanager
def stock(*words: str) -> Iterator[None]:
    """Aravis' own program, with these arguments."""
    with turn():
        camera = subprocess.Popen([program("arv-fake-gv-camera"), "-i", VIRTUAL_ADDRESS, *words])
        try:
            yield
        finally:
            camera.kill()
            camera.wait()


def client(clock: Clock, **options: object) -> GenicamCamera:
    """The driver's camera at that address."""
    given = {"camera": VIRTUAL_ADDRESS, "resend": False, "wait_s": 20.0} | options
    return GenicamCamera(GenicamOptions(**given), clock, 1_000_000)  # type: ignore[arg-type]


def shoot(camera: GenicamCamera, settings: CameraSettings = SETTINGS) -> PhotoFrame:
    """One exposure as the rig takes it, closed when it was planned to be."""
    camera.arm(settings)
    open_ns = camera.begin()
    camera.clock.sleep_until_ns(open_ns + round((settings.exposure_s or 0.0) * 1e9))
    camera.end()
    return camera.fetch(60.0)


def blacks(photo: PhotoFrame) -> list[int]:
    """Level without light of each place of the quad, or of the one place."""
    return [photo.black] if isinstance(photo.black, int) else list(photo.black)
