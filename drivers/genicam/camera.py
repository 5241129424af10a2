"""One camera's exposures and frames: what a shutter and a readout share.

A timed exposure ends by the camera's own clock. It is a little longer than planned, so that panels
may be late. It has surely begun once the trigger was answered, and is surely over when its time has
passed since then. If the panels still showed codes after that, the exposure is lost, as is one
whose frame did not come whole; both raise PhotoError, so that the photo is taken again.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from pdcd.driver import (
    CameraSettings,
    Clock,
    ConfigError,
    DeviceLost,
    DriverContext,
    ExposureError,
    Patience,
    PhotoError,
    PhotoFrame,
)

from .counters import PULSES_HINT
from .device import CAMERA_DEVICE, GenicamDevice
from .exposure import TimedExposure, check_exposed
from .frames import FrameReceiver
from .levels import measure_black
from .options import GenicamOptions, read_genicam_options

_READY_S = 1.0
"""Longest time until a camera waits for a trigger, and until it has accepted one: some need most of
a second after settings were changed."""
_POLL_S = 0.002
_SHORT_S = 0.2
"""Exposures shorter than this may be over before they are seen to begin."""
_SEEN_S = 0.5
"""Shortest wait to see an exposure begin; a virtual clock must not be moved before that."""
_EARLY_S = 0.25
"""An exposure that would go on for this long plus all its margin is abandoned instead."""
_STRAY_S = 0.3
"""After an abandoned exposure no frame must come for this long: its own may be on its way."""
_BLACK_TRIES = 3
_BACK_S, _LOOK_BACK_S = 3.5, 0.1
"""How long a lost camera is looked for before an exposure, and the pause between looks. Each look
may take the time to release the old one (1 s) and for an unanswered command (2.5 s, 5 with a
heartbeat), so a job without its camera ends within ten seconds."""


class GenicamCamera:
    """A camera by its options, open while a shutter or a readout needs it.

    A camera that was lost is not trusted any more, even if it seems to answer: the next `open` or
    `arm` opens it anew; `arm` waits for it to come back.
    """

    def __init__(
        self,
        options: GenicamOptions,
        clock: Clock,
        sure_ns: int,
        patience: Patience | None = None,
        moves: Callable[[], bool] = lambda: False,
    ) -> None:
        """`moves` says whether the next exposure begins and ends while panels are lit, so that it
        must be exactly as long as planned."""
        self.options = options
        self._moves = moves
        self.clock = clock
        self._sure_ns = sure_ns
        self._patience = patience or Patience(clock)
        self._users: set[str] = set()
        self._device: GenicamDevice | None = None
        self._frames: FrameReceiver
        self._settings: CameraSettings | None = None
        self._time: tuple[float, float] | None = None
        """Of the next exposure: the time set in the camera, and the margin in it, s."""
        self._planned_s: float | None = None
        self._exposure: TimedExposure | None = None
        self._owes_frame = False
        """Whether the frame of an abandoned exposure may still come."""
        self._black: dict[int, int | Sequence[int]] = {}
        self._primed = False
        """Whether a frame has come since the camera was opened. For network cameras the library
        allocates room when the first frame comes, which is too late for that one if it is large."""
        self._let_go: Callable[[], object] = lambda: None
        self._identity: dict[str, str] = {}

    @classmethod
    def of(cls, context: DriverContext) -> GenicamCamera:
        """The camera of this rig; made by the first driver that asks."""

        def make() -> GenicamCamera:
            config = context.config
            options = read_genicam_options(config)
            if "genicam" in (config.camera.driver, config.trigger.driver):
                context.require_real_time("camera", "camera")
            return cls(options, *list_camera_parts(context))

        return context.the(cls, make)

    @property
    def device(self) -> GenicamDevice:
        """The open camera. Raises DeviceLost if there is none, or it was lost."""
        if self._device is None or self._device.lost:
            raise DeviceLost(
                "the camera is not connected",
                device=CAMERA_DEVICE,
                hint="connect it and start again",
            )
        return self._device

    def open(self, user: str) -> GenicamDevice:
        """Open the camera for this user; a lost camera is opened anew. Raises DeviceLost,
        ConfigError."""
        if self._device is not None and self._device.lost:
            self._drop()
        if self._device is None:
            self._patience.look()
            self._device = device = GenicamDevice(self.options)
            self._let_go = weakref.finalize(self, device.close)
            self._exposure = self._time = None
            self._primed = False
            self._black.clear()
            self._frames = FrameReceiver(device, self._patience)
            with self._trusted():
                self._check_same(device)
        self._users.add(user)
        return self._device

    def _check_same(self, device: GenicamDevice) -> None:
        """Raise DeviceLost if it is not the camera that its users know."""
        found = device.identity
        if self._users and found != self._identity:
            raise DeviceLost(
                f"another camera answers: {' '.join(found.values())}",
                device=CAMERA_DEVICE,
                hint="connect the one that was there, or start again",
            )
        self._identity = found

    def close(self, user: str) -> None:
        """End the use by this user; after the last one the camera is released. Idempotent."""
        self._users.discard(user)
        if not self._users:
            self._settings = None
            self._drop()

    def arm(self, settings: CameraSettings) -> None:
        """Set gain and exposure; find the black level; drop frames of earlier exposures.

        Nothing is exposed yet, so a camera that was lost since is looked for, and opened anew.
        Raises ConfigError for an ISO or a time that the camera does not offer, DeviceLost if it
        does not come back.
        """
        self._settings = None
        until_s, pause = time.monotonic() + _BACK_S, threading.Event()
        while True:
            try:
                self._arm(settings)
            except DeviceLost:
                if time.monotonic() > until_s:
                    raise
                pause.wait(_LOOK_BACK_S)
                self._patience.look()
            else:
                self._settings = settings
                return

    def _arm(self, settings: CameraSettings) -> None:
        with self._trusted():
            device = self.open("readout")
            if not device.ask_ours():
                device = self.open("readout")
            if self._owes_frame or (self._exposure is not None and not self._exposure.closed):
                device.abort()
                self._await_ready(device)
                self._frames.forget(_STRAY_S)
            self._exposure, self._owes_frame = None, False
            device.set_gain(settings.iso)
            if settings.iso not in self._black or not self._primed:
                self._black[settings.iso] = self._find_black()
            self._plan(settings.exposure_s)
            device.restart_counters()
            self._frames.forget()

    def expect(self, exposure_s: float) -> None:
        """Set the planned length of the next exposure. Raises ConfigError if it is not possible."""
        with self._trusted():
            self._plan(exposure_s)

    def begin(self) -> int:
        """Start an exposure; returns the time by which it surely has begun."""
        with self._trusted():
            device = self.device
            if self._exposure is not None and not self._exposure.closed:
                raise ExposureError(
                    "an exposure goes on already",
                    device=CAMERA_DEVICE,
                    hint="close the shutter first",
                )
            if self._moves() and self._planned_s is not None:
                self._plan(self._planned_s, exact=True)
            time_s, spare_s = self._time or self._plan(None)
            self._time = self._planned_s = None
            self._frames.forget()
            if self.options.exposure == "edge":
                now_ns = self.clock.now_ns()
                self._exposure = TimedExposure(now_ns, now_ns, time_s, spare_s)
                return now_ns
            return self._start(device, time_s, spare_s).sure_ns

    def _start(self, device: GenicamDevice, time_s: float, spare_s: float) -> TimedExposure:
        """Start an exposure by command; on return it surely has begun."""
        self._await_ready(device)
        self._frames.forget()
        begun_ns = self.clock.now_ns()
        self._owes_frame = True  # from here on it may have begun, even if something fails
        device.trigger()
        told = self._await_start(device, time_s)
        self._owes_frame = False
        sure_ns = self.clock.now_ns() + (0 if told else self._sure_ns)
        exposure = self._exposure = TimedExposure(begun_ns, sure_ns, time_s, spare_s)
        self.clock.sleep_until_ns(sure_ns)
        return exposure

    def end(self) -> int:
        """Wait until an exposure is surely over; returns the time by which it was.

        An exposure that would go on for long is abandoned. Without one there is nothing to do.
        """
        exposure = self._exposure
        now_ns = self.clock.now_ns()
        if exposure is None or exposure.closed:
            return now_ns
        exposure.closed = True
        exposure.late_s = 1e-9 * (now_ns - exposure.ends_ns)
        if exposure.late_s < -exposure.spare_s - _EARLY_S:
            exposure.aborted = True
            with self._trusted():
                self.device.abort()
            return self.clock.now_ns()
        if self.options.exposure == "edge":
            # It is not known when it began: its frame shows that it is over.
            with self._trusted():
                try:
                    exposure.came = self._frames.wait(exposure.time_s + self.options.wait_s)
                except PhotoError as err:
                    exposure.came = err
            return self.clock.now_ns()
        return self._outlive(exposure)

    def _outlive(self, exposure: TimedExposure) -> int:
        """Wait until it is surely over; returns the time."""
        while (now_ns := self.clock.now_ns()) < exposure.over_ns:
            self._patience.sleep_until_ns(exposure.over_ns)
        return now_ns

    def fetch(self, timeout_s: float) -> PhotoFrame:
        """The photo of the last exposure.

        Raises PhotoError if it was lost, is not whole or did not see all of the exposure,
        ExposureError if there was no exposure, DeviceLost if the camera does not answer.
        """
        settings, self._settings = self._settings, None
        exposure, self._exposure = self._exposure, None
        if settings is None:
            raise ExposureError(
                "the camera was not armed", device=CAMERA_DEVICE, hint="call arm first"
            )
        if self.options.exposure != "width":
            check_exposed(exposure)
        with self._trusted():
            self._owes_frame = True
            timed = self.options.exposure == "timed" and not self._moves()
            if timed and exposure is not None and exposure.late_s > 0.0:
                raise PhotoError(
                    f"the panels were done {exposure.late_s:.3g} s after the exposure of "
                    f"{exposure.time_s:.3g} s had ended",
                    device=CAMERA_DEVICE,
                    hint="raise camera.options.margin_s, or see why refreshes are late",
                )
            came = None if exposure is None else exposure.came
            if isinstance(came, PhotoError):
                raise came
            buffer = came or self._frames.wait(min(timeout_s, self.options.wait_s))
            self._owes_frame = False
            device = self.device
            levels, known = device.levels, device.levels.swapped
            samples = self._frames.unpack(buffer)
            if levels.swapped and not known:
                self._black.clear()
                raise PhotoError(
                    "the bytes of samples come the wrong way round, which nothing showed before: "
                    "black is another level than was measured",
                    device=CAMERA_DEVICE,
                    hint="take it again",
                )
            pulses = device.count_pulses()
            record = device.record()
        return PhotoFrame(
            samples,
            black=self._black[settings.iso],
            white=levels.white_dn,
            iso=settings.iso,
            exposure_s=0.0 if exposure is None else exposure.time_s,
            f_number=settings.f_number,
            cfa=device.pixel_format.cfa,
            record=record
            | {"FrameID": f"{buffer.frame_id}", "Timestamp": f"{buffer.timestamp_ns}"},
            pulses=pulses,
            pulses_hint=PULSES_HINT,
        )

    def _plan(self, exposure_s: float | None, *, exact: bool = False) -> tuple[float, float]:
        """Set the time of the next exposure, and the margin in it."""
        options = self.options
        self._planned_s = exposure_s
        if options.exposure == "width":
            return (0.0, 0.0)
        if exposure_s is None:
            whole_s = spare_s = options.unplanned_s
        else:
            spare_s = 0.0 if exact else options.margin_s + options.margin * exposure_s
            # It may begin at once, and be believed to begin so much later.
            spare_s += 1e-9 * self._sure_ns
            whole_s = exposure_s + spare_s
        set_s = self.device.set_exposure(whole_s)
        self._time = (set_s, spare_s)
        return self._time

    def _find_black(self) -> int | Sequence[int]:
        """Level without light at the present gain: configured, or measured in the shortest
        exposure. A camera that was just opened makes that exposure in any case, as its first frame.
        """
        told = self.options.black_dn
        if told is not None and self._primed:
            return told
        device = self.device
        by_line = self.options.exposure != "timed"
        if by_line:
            device.set_start("timed")
        try:
            seen = self._see_black(device)
        except PhotoError:
            if told is None:
                raise
        finally:
            if by_line:
                device.set_start(self.options.exposure)
        self._primed = True
        return seen if told is None else told

    def _see_black(self, device: GenicamDevice) -> int | Sequence[int]:
        """The level that the shortest exposure shows; a lost frame is taken again."""
        for left in range(_BLACK_TRIES - 1, -1, -1):
            set_s = device.set_exposure(device.shortest_s)
            self._frames.forget()
            self._outlive(self._start(device, set_s, set_s))
            self._exposure = None
            try:
                samples = self._frames.unpack(self._frames.wait(self.options.wait_s))
            except PhotoError:
                if not left:
                    raise
            else:
                return measure_black(samples, device.pixel_format.cfa)
        raise AssertionError

    def _await_ready(self, device: GenicamDevice) -> None:
        if not self._poll(device.waits_for_trigger, False, _READY_S):
            raise PhotoError(
                f"the camera was not ready for a trigger within {_READY_S:g} s",
                device=CAMERA_DEVICE,
                hint="take it again",
            )

    def _await_start(self, device: GenicamDevice, time_s: float) -> bool:
        """Wait until the exposure is seen to begin; False if the camera does not report it."""
        if device.waits_for_trigger() is None:
            return False
        began = self._poll(device.waits_for_trigger, True, max(_SEEN_S, min(_READY_S, time_s)))
        if not began and time_s >= _SHORT_S:
            raise PhotoError(
                "the camera did not take the trigger", device=CAMERA_DEVICE, hint="take it again"
            )
        return began

    def _poll(self, ask: Callable[[], bool | None], unwanted: bool, longest_s: float) -> bool:
        """Ask until the answer is not `unwanted`, for at most `longest_s`."""
        pause = threading.Event()
        for _ in range(max(1, round(longest_s / _POLL_S))):
            if ask() is not unwanted:
                return True
            self._patience.look()
            pause.wait(_POLL_S)
        return False

    @contextmanager
    def _trusted(self) -> Iterator[None]:
        """Mark a camera that did not answer: it is opened anew before it is used again."""
        try:
            yield
        except DeviceLost:
            if self._device is not None:
                self._device.distrusted = True
            raise
        except ConfigError:
            if self._device is not None:
                self._device.check_ours()  # a restarted camera refuses, too
            raise

    def _drop(self) -> None:
        self._device = self._exposure = self._time = None
        self._let_go()


def list_camera_parts(
    context: DriverContext,
) -> tuple[Clock, int, Patience, Callable[[], bool]]:
    """What a `GenicamCamera` of this rig needs besides its options."""
    shared = context.shared
    return context.clock, context.config.trigger.sure_ns, context.patience, lambda: shared.moving
