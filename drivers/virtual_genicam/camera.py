"""A machine-vision camera that is not there: exposures in time, frames of what a film shows.

The simulator sends frames. A thread here decides when, and what they show, by reading the
simulator's registers: a trigger begins an exposure, the clock or the line's level ends it, and then
the frame is sent. So exposures take real time, and the simulator keeps answering its heartbeat.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import Clock

from ..genicam.pixels import BY_CODE, PixelFormat, pack_samples
from .description import (
    COUNTER_SOURCES,
    COUNTERS,
    EXPOSURE_MODES,
    STARTED,
    STARTED_ANEW,
    TRIGGER_ACTIVATIONS,
    TRIGGER_SOURCES,
    CameraDescription,
    Register,
    write_description,
)
from .simulator import HostedSimulator

logger = logging.getLogger(__name__)

_LOOK_S, _IDLE_S = 0.002, 0.02
"""Interval of reading the registers while frames may be wanted, and while none are."""
_QUIET = 150
"""After this many readings without news the client is probably computing; it gets the processor."""
_SEND_S = 5.0
_WARM_CC = 4150
_HEARTBEAT_MS = 60_000
"""How long the client may be silent. Client and camera are threads of the same process, and on a
busy machine the client may be late."""


@dataclass(frozen=True)
class VirtualExposure:
    """One exposure: its times by the camera's clock, and the camera's settings."""

    open_ns: int
    close_ns: int
    gain_db: float
    width: int
    height: int
    pixel_format: PixelFormat

    @property
    def exposure_s(self) -> float:
        """Length of the exposure."""
        return 1e-9 * (self.close_ns - self.open_ns)


class LightFilm(Protocol):
    """What lies behind the sensor. Called on the camera's own thread, one call at a time."""

    def open(self, asked_ns: int, exposure_s: float | None) -> int:
        """Begin an exposure of `exposure_s`, or for as long as a line holds it; returns the time at
        which it really begins."""
        ...

    def close(self, asked_ns: int) -> int:
        """End the exposure; returns the time at which it really ends."""
        ...

    def make_samples(self, exposure: VirtualExposure) -> NDArray[np.uint16]:
        """The samples of the exposure, (height, width), in the format's bits."""
        ...


@dataclass
class CameraFaults:
    """What the camera shall do wrong; may be changed while it runs.

    lost : share of packets that are lost. swapped : samples of two bytes come with their bytes
    swapped. left : samples are shifted to the left by so many bits. killed_after_s : the camera
    dies after that time in the next exposure. silent : frames are never sent.
    """

    lost: float = 0.0
    swapped: bool = False
    left: int = 0
    killed_after_s: float | None = None
    silent: bool = False


@dataclass
class _Running:
    open_ns: int
    closes_ns: int | None
    since_ns: int


@dataclass
class VirtualGenicamCamera:
    """A virtual camera, which can be reached at `VIRTUAL_ADDRESS` between `start` and `stop`.

    count_pulses : counts pulses at an input, "Line2" or "Line3", from one time to before another.
    exposures : number completed. missed : triggers that came during an exposure.
    """

    description: CameraDescription
    film: LightFilm
    clock: Clock
    faults: CameraFaults = field(default_factory=CameraFaults)
    count_pulses: Callable[[str, int, int], int] = lambda _line, _low_ns, _high_ns: 0
    exposures: int = 0
    missed: int = 0
    _begun: int = 0
    _line: bool = False
    _frame: bytes = b""
    _running: _Running | None = None
    _simulator: HostedSimulator | None = None
    _thread: threading.Thread | None = None
    _ended: threading.Event = field(default_factory=threading.Event)

    def start(self) -> None:
        """Begin to listen. Idempotent. Raises DeviceLost if the address is taken."""
        if self._simulator is not None:
            return
        description = self.description
        simulator = HostedSimulator(
            write_description(description), description.serial, lambda: self._frame
        )
        simulator.write_text(Register.VENDOR, "pdcd", 32)
        simulator.write_text(Register.MODEL, "virtual GenICam", 32)
        for address, value in (
            (Register.SENSOR_WIDTH, description.width),
            (Register.SENSOR_HEIGHT, description.height),
            (Register.WIDTH, description.width),
            (Register.HEIGHT, description.height),
            (Register.PIXEL_FORMAT, description.formats[0].code),
            (Register.WHITE, description.white or 0),
            (Register.EXPOSURE_US, 10_000),
            (Register.TEMPERATURE_CC, _WARM_CC),
            (Register.SENDS_BY_TRIGGER, 1),
            (Register.SENDS_BY_COMMAND, 1),
            (Register.WAITS, 1),
            (Register.HEARTBEAT_MS, _HEARTBEAT_MS),
        ):
            simulator.write(address, value)
        self._simulator, self._running = simulator, None
        self._ended = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(simulator, self._ended), name="virtual GenICam", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Go silent, as if the cable were pulled. Idempotent."""
        thread, self._thread = self._thread, None
        simulator, self._simulator = self._simulator, None
        self._ended.set()
        if thread is not None and thread is not threading.current_thread():
            thread.join()
        if simulator is not None:
            simulator.close()

    @property
    def exposing(self) -> bool:
        """Whether an exposure is under way."""
        return self._running is not None

    def hold_line(self, level: bool) -> None:
        """Set the level of the camera's input."""
        self._line = level

    def _run(self, simulator: HostedSimulator, ended: threading.Event) -> None:
        """Read the registers repeatedly until the camera is stopped."""
        lost, before, quiet = 0.0, self._line, 0
        while not ended.is_set():
            if self.faults.lost != lost:
                lost = self.faults.lost
                simulator.lose_packets(lost)
            started = simulator.read(Register.ACQUISITION)
            wanted = started and simulator.read(Register.CONTROL)
            if not wanted or started == STARTED_ANEW:
                self._give_up()
                simulator.write(Register.WAITS, 1)
            if started == STARTED_ANEW:
                simulator.write(Register.ACQUISITION, STARTED)
            line = self._line
            begun = self._begun
            self._look(simulator, ended, rose=line and not before, fell=before and not line)
            before = line
            by_command = simulator.read(Register.TRIGGER_SOURCE) == TRIGGER_SOURCES["Software"]
            idle = by_command and self._running is None and begun == self._begun
            quiet = quiet + 1 if idle else 0
            ended.wait(_LOOK_S if wanted and quiet < _QUIET else _IDLE_S)
        self._give_up()

    def _count(self, simulator: HostedSimulator, exposure: VirtualExposure) -> None:
        """Add the pulses of an exposure to the counters."""
        lines = {value: line for line, value in COUNTER_SOURCES.items() if value}
        for number in range(len(COUNTERS)):
            line = lines.get(simulator.read(Register.COUNTER_SOURCES + 4 * number))
            if line is not None:
                count = self.count_pulses(line, exposure.open_ns, exposure.close_ns)
                place = Register.COUNTER_VALUES + 4 * number
                simulator.write(place, simulator.read(place) + count)

    def _give_up(self) -> None:
        """End an exposure without sending a frame."""
        running, self._running = self._running, None
        if running is not None:
            self.film.close(self.clock.now_ns())

    def _look(
        self, simulator: HostedSimulator, ended: threading.Event, *, rose: bool, fell: bool
    ) -> None:
        by_width = simulator.read(Register.EXPOSURE_MODE) == EXPOSURE_MODES["TriggerWidth"]
        if simulator.read(Register.TRIGGER_ACTIVATION) == TRIGGER_ACTIVATIONS["FallingEdge"]:
            rose, fell = fell, rose
        if self._triggered(simulator, rose=rose):
            if self._running is not None:
                self.missed += 1  # real cameras, too, count it and go on
            else:
                self._begin(simulator, by_width=by_width)
        running, now_ns = self._running, self.clock.now_ns()
        if running is None:
            return
        killed_s = self.faults.killed_after_s
        if killed_s is not None and now_ns >= running.since_ns + round(killed_s * 1e9):
            self.faults.killed_after_s = None
            self.stop()
            return
        if by_width and fell:
            self._end(simulator, ended, running, now_ns)
        elif running.closes_ns is not None and now_ns >= running.closes_ns:
            self._end(simulator, ended, running, running.closes_ns)

    def _triggered(self, simulator: HostedSimulator, *, rose: bool) -> bool:
        by_command = simulator.read(Register.TRIGGER) != 0
        if by_command:
            simulator.write(Register.TRIGGER, 0)
        if not (simulator.read(Register.TRIGGER_MODE) and simulator.read(Register.ACQUISITION)):
            return False
        return (
            by_command
            if simulator.read(Register.TRIGGER_SOURCE) == TRIGGER_SOURCES["Software"]
            else rose
        )

    def _begin(self, simulator: HostedSimulator, *, by_width: bool) -> None:
        now_ns = self.clock.now_ns()
        exposure_s = None if by_width else 1e-6 * simulator.read(Register.EXPOSURE_US)
        open_ns = self.film.open(now_ns, exposure_s)
        closes_ns = None if exposure_s is None else open_ns + round(exposure_s * 1e9)
        self._running = _Running(open_ns, closes_ns, now_ns)
        self._begun += 1
        simulator.write(Register.WAITS, 0)

    def _end(
        self, simulator: HostedSimulator, ended: threading.Event, running: _Running, at_ns: int
    ) -> None:
        """End the exposure, and send its frame."""
        exposure = VirtualExposure(
            open_ns=running.open_ns,
            close_ns=self.film.close(at_ns),
            gain_db=0.01 * simulator.read(Register.GAIN_CDB),
            width=simulator.read(Register.WIDTH),
            height=simulator.read(Register.HEIGHT),
            pixel_format=BY_CODE[simulator.read(Register.PIXEL_FORMAT)],
        )
        self._running = None
        self.exposures += 1
        try:
            samples = self.film.make_samples(exposure)
        # A film may raise anything; the camera goes on, without that frame.
        except Exception as err:
            logger.error("no frame was made error=%s: %s", type(err).__name__, err)
            simulator.write(Register.WAITS, 1)
            return
        self._count(simulator, exposure)
        if not self.faults.silent:
            self._send(simulator, ended, samples, exposure.pixel_format)
        simulator.write(Register.WAITS, 1)

    def _send(
        self,
        simulator: HostedSimulator,
        ended: threading.Event,
        samples: NDArray[np.uint16],
        pixel_format: PixelFormat,
    ) -> None:
        samples = np.left_shift(samples, np.uint16(self.faults.left))
        if self.faults.swapped and pixel_format.layout == "words":
            samples = samples.byteswap()
        self._frame = pack_samples(samples, pixel_format)
        simulator.write(Register.SEND, 1)
        # The next frame would overwrite this one.
        for _ in range(round(_SEND_S / _LOOK_S)):
            if simulator.read(Register.SEND) == 0 or ended.wait(_LOOK_S):
                return
