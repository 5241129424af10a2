"""Who plays a recorded stream in real time: a display here, and the camera and the mock bench in
processes of their own.

Each opening of the shutter sends an order: the number of a recorded photo. The camera serves the
samples of the newest order, so that a photo that was spoilt shifts nothing. Where there is a mock,
it gets the order, and hands on where the samples lie that it made.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.genicam.pixels import BY_NAME
from drivers.virtual_genicam.camera import VirtualExposure, VirtualGenicamCamera
from drivers.virtual_genicam.description import CameraDescription
from pdcd.bench.clock import RealClock
from pdcd.bench.devices import Clock, DisplayInfo
from pdcd.capture.rig import Rig
from pdcd.errors import Cancelled
from pdcd.panels.frames import FrameLog, Frames
from tests.plain_film import PlainFilm
from tests.stream_bench.recorded import (
    MirrorLight,
    MirrorTimes,
    RecordedPhoto,
    RecordedStream,
    shift_log,
)

Mode = Literal["ring", "chain", "moving"]
_DARK_S, _LATE_S, _LOOK_S = 1e-3, 10.0, 0.05
_EDGE_NS = 105_000
"""From the camera's edge to the first row."""
_SLOTS = 4
"""Frames of the mock that lie about at once."""
_STEPS, _WAVES, _DEPTH = 64, 3.0, 0.4
"""Of a scene that moves: places of its stripes, stripes, and how much darker they are."""


class PlayedDisplay:
    """Two DMDs as their driver told of them, without the driver: what an exposure shows was
    recorded, and takes its time again."""

    def __init__(self, info: DisplayInfo, clock: Clock) -> None:
        self._info, self._clock = info, clock
        self._frames: Frames | None = None
        self.photo: RecordedPhoto | None = None
        self.open_ns = 0

    def connect(self) -> DisplayInfo:
        """As it was."""
        return self._info

    def load(self, frames: Frames) -> None:
        """What is to be shown."""
        self._frames = frames

    def black(self) -> None:
        """It is."""

    def show(self, frames: Frames) -> None:
        """Nothing that anybody sees."""

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        """Wait for as long as it took, and tell what was told."""
        frames, photo = self._frames, self.photo
        assert frames is not None and photo is not None
        asked, known = frames, photo.frames
        for name in ("primal_patterns", "dual_patterns", "primal_index", "dual_index"):
            assert np.array_equal(getattr(asked, name), getattr(known, name)), photo.name
        # Who asks by USB sees a sequence only when it is over, and later than it was.
        begun_ns = int(photo.log.primal_ns[0]) - _EDGE_NS
        log = shift_log(photo.log, self.open_ns - begun_ns)
        end_ns = int(log.end_ns.max())
        while (now_ns := self._clock.now_ns()) < end_ns:
            if cancelled():
                raise Cancelled("cancelled while the codes were shown", device="display")
            self._clock.sleep_until_ns(min(end_ns, now_ns + round(_LOOK_S * 1e9)))
        progress(len(frames), len(frames), 0)
        return log

    def disconnect(self) -> None:
        """It stays black."""


class Player:
    """Has a rig's display play a recorded stream, and orders the photo of each exposure."""

    def __init__(self, rig: Rig, recorded: RecordedStream, send: Callable[[int], None]) -> None:
        self._photos, self._send = recorded.photos, send
        self._next: dict[str, int] = {}
        self._of_name: dict[str, list[int]] = {}
        for number, photo in enumerate(recorded.photos):
            self._of_name.setdefault(photo.name, []).append(number)
        self._name = ""
        self.played: int | None = None
        self._display = PlayedDisplay(recorded.display, rig.clock)
        rig.display = self._display
        self._expose, self._open = rig.expose, rig.shutter.open
        rig.expose = self._follow  # type: ignore[method-assign]
        rig.shutter.open = self._begin  # type: ignore[method-assign]

    def _follow(self, frames: Frames, settings: Any, folder: Path, name: str, **more: Any) -> Any:
        self._name = name
        return self._expose(frames, settings, folder, name, **more)

    def _begin(self) -> int:
        known = self._of_name[self._name]
        count = self._next.get(self._name, 0)
        self._next[self._name] = count + 1
        self.played = known[count % len(known)]
        self._display.photo = self._photos[self.played]
        self._send(self.played)
        self._display.open_ns = open_ns = self._open()
        return open_ns


def serve_camera(path: Path, shape: tuple[int, int], orders: Connection, ready: Connection) -> None:
    """Be the camera: serve frames of a file by their numbers, until the orders end."""
    frames = np.load(path, mmap_mode="r")

    def make(exposure: VirtualExposure) -> NDArray[np.uint16]:
        if exposure.exposure_s < _DARK_S or not orders.poll(_LATE_S):
            return np.zeros(shape, np.uint16)
        while orders.poll():  # the newest counts
            number = int(orders.recv())
        return np.asarray(frames[number])

    description = CameraDescription(shape[1], shape[0], (BY_NAME["Mono16"],), white=4095)
    camera = VirtualGenicamCamera(description, PlainFilm(make), RealClock())
    camera.start()
    ready.send("ready")
    ready.poll(None)
    camera.stop()


def be_mock(
    size: str, photos: list[MirrorTimes], path: Path, orders: Connection, made: Connection,
    moving: bool, ready: Connection,
) -> None:  # fmt: skip
    """Be the mock bench: light of mirrors as they moved, once for each that moved otherwise, and
    noise of its own in each photo; of a scene that moves, stripes of it elsewhere in each."""
    mirrors, slots = MirrorLight(size), np.load(path, mmap_mode="r+")
    known: dict[int, NDArray[np.float64]] = {}
    count = 0
    ready.send("ready")
    while True:
        try:
            number = int(orders.recv())
        except EOFError:
            return
        if number not in known:
            known[number] = mirrors.see(photos[number])
        light = known[number]
        if moving:
            light = light * make_stripes(count, light.shape[1])[:, None]
        close_s = 1e-9 * photos[number].close_ns
        slots[count % _SLOTS] = mirrors.expose(light, close_s)
        made.send(count % _SLOTS)
        count += 1


def make_stripes(count: int, columns: int) -> NDArray[np.float64]:
    """How bright each column of a scene is that moves, in its photo of that number."""
    phase = np.arange(columns) / columns * _WAVES + count / _STEPS
    return np.asarray(1.0 - _DEPTH * (0.5 + 0.5 * np.cos(2.0 * np.pi * phase)))


@dataclass(frozen=True)
class Players:
    """Processes beside the product. send : orders the frame of a photo."""

    camera: int
    mock: int | None
    send: Callable[[int], None]


def _begin(held: ExitStack, target: Callable[..., None], *args: Any) -> tuple[BaseProcess, Any]:
    """A process that is ready, and the end of a pipe by whose closing it ends."""
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe()
    process = spawn.Process(target=target, args=(*args, there), daemon=True)
    process.start()

    def end() -> None:
        process.kill()
        process.join()

    held.callback(end)
    assert here.poll(120.0) and here.recv() == "ready"
    return process, here


@contextmanager
def players(recorded: RecordedStream, mode: Mode, size: str, folder: Path) -> Iterator[Players]:
    """The camera, and the mock where frames are made as they are wanted."""
    path, shape = folder / "frames.npy", recorded.photos[0].samples.shape
    with ExitStack() as held:
        receive, send = multiprocessing.Pipe(duplex=False)
        if mode == "ring":
            np.save(path, np.stack([photo.samples for photo in recorded.photos]))
            camera, _ = _begin(held, serve_camera, path, shape, receive)
            assert camera.pid is not None
            yield Players(camera.pid, None, send.send)
            return
        np.save(path, np.zeros((_SLOTS, *shape), np.uint16))
        wanted, order = multiprocessing.Pipe(duplex=False)
        mock, _ = _begin(
            held, be_mock, size, [photo.mirrors for photo in recorded.photos], path, wanted, send,
            mode == "moving",
        )  # fmt: skip
        camera, _ = _begin(held, serve_camera, path, shape, receive)
        assert camera.pid is not None
        yield Players(camera.pid, mock.pid, order.send)
