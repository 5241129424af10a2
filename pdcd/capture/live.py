"""A live view: a pattern on the panels, and the camera's finder, until somebody ends it.

The finder has a thread of its own. A camera that is not done, or hangs, blocks only the finder's
thread, which is left behind, not the rig's: panels go black, and the job ends. The next job that
needs the camera waits until its last picture is due, and then fails with the message that the
camera hangs.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.devices import Preview
from pdcd.bench.registry import list_known_drivers, load_driver
from pdcd.capture.job import make_failure, mark_unsafe, to_job_error
from pdcd.capture.live_frame import LiveFrames
from pdcd.capture.raw_finder import RawFinder
from pdcd.capture.rig import Rig
from pdcd.errors import Cancelled, DeviceLost, PdcdError
from pdcd.panels.frames import Frames
from pdcd.protocol.result import CaptureResult
from pdcd.protocol.views import LiveFrame

logger = logging.getLogger(__name__)

_LOOK_S = 0.05
"""Time between two checks for a cancel."""
_MOST_HZ = 30.0
"""Most pictures per second: nobody sees more, and each costs work."""
_SILENT_S, _FIRST_S = 5.0, 60.0
"""How long a finder may take for a picture, and in addition for its first: some compute it. For
photos, `camera.fetch_timeout_s` is the limit."""
_OVER_S = 2.0
"""Time that a call gets beyond its limit before it counts as hanging."""
_GRACE_S = 2.0
"""How long a finder may take to end, with the panels black already."""

_Asked = Callable[[], bool]
_Came = tuple[int, NDArray[np.uint8]]
"""When a picture came, in ns of the monotonic clock, and the picture."""


class FinderThread:
    """Asks a finder for one picture after the other in a thread of its own. Only the newest is
    kept."""

    def __init__(self, finder: Preview, longest_s: float) -> None:
        self._finder, self._longest_s = finder, longest_s
        self._ends = threading.Event()
        self._changed = threading.Condition()
        self._newest: _Came | None = None
        self._due_s = 0.0
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="pdcd-finder", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._expect(_FIRST_S)
        self._thread.start()

    @property
    def is_late(self) -> bool:
        """Whether the next picture is overdue."""
        return time.monotonic() > self._due_s

    def wait(self, heard: Callable[[], object]) -> None:
        """Wait until the thread has left the finder. `heard()` is called meanwhile and may raise.
        Raises DeviceLost where the last picture is overdue."""
        while self._thread.is_alive():
            if self.is_late:
                raise _make_lost()
            heard()
            self._thread.join(_LOOK_S)

    def take(self, within_s: float) -> _Came | None:
        """The newest picture that was not taken yet, None where none comes within that time. Raises
        what the finder raised."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest or self._error, within_s)
            if self._newest is None and self._error is not None:
                raise self._error
            came, self._newest = self._newest, None
        return came

    def end(self, within_s: float) -> bool:
        """Stop asking; returns whether the finder was left in order within that time."""
        self._ends.set()
        self._thread.join(within_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._finder.connect()
            try:
                self._ask()
            finally:
                self._finder.disconnect()
        except BaseException as err:  # a driver may not end the program
            if self._ends.is_set():
                logger.info("finder ended error=%s", err)
            with self._changed:
                self._error = err
                self._changed.notify_all()

    def _expect(self, more_s: float = 0.0) -> None:
        """Expect a picture within the time that one may take, plus so many seconds."""
        self._due_s = time.monotonic() + more_s + self._longest_s + _OVER_S

    def _ask(self) -> None:
        due_s = 0.0
        while not self._ends.wait(max(0.0, due_s - time.monotonic())):
            due_s = time.monotonic() + 1.0 / _MOST_HZ
            picture = self._finder.grab(self._longest_s)
            self._expect()
            with self._changed:
                self._newest = time.monotonic_ns(), picture
                self._changed.notify_all()


def run_live_view(
    rig: Rig,
    draw: Callable[[], Frames | None],
    *,
    job: str,
    tell: Callable[[LiveFrame], object],
    cancelled: _Asked,
    ended: _Asked,
) -> CaptureResult:
    """Hold the first of the frames that `draw` makes (None: black) and report each picture until
    the end; errors are in the result, not raised. On return panels are black and the shutter is
    closed, or the last warning says that they may not be.

    `cancelled()` ends it as a cancelled job, `ended()` as a finished one; both are called at least
    ten times a second. Called by `Engine.live` in the rig's thread.
    """
    thread: FinderThread | None = None
    made: LiveFrames | None = None
    failure: PdcdError | None = None
    with rig.pulse.of_job(lambda: cancelled() or ended()):
        try:
            rig.look_at_finder()
            frames = rig.context.shared.held = draw()
            if frames is not None:
                rig.display.show(frames)
            finder, longest_s = _make_finder(rig)
            camera = rig.camera_info
            made = LiveFrames(rig.config, None if camera is None else camera.frame_quads)
            thread = FinderThread(finder, longest_s)
            thread.start()
            _pass_on(thread, made, tell, cancelled, ended)
        except BaseException as err:
            failure = to_job_error(err, "live view", job)
        finally:
            safe = _make_dark(rig, thread)
    if isinstance(failure, Cancelled):  # wherever it was heard
        failure = None if ended() and not cancelled() else _make_end()
    if failure is None:
        result = CaptureResult(
            job=job, state="done", summary={"pictures": made.count if made else 0}
        )
    else:
        result = make_failure(job, None, rig.clock.now_ns(), failure, safe=safe)
    return result if safe else mark_unsafe(result)


def _make_finder(rig: Rig) -> tuple[Preview, float]:
    """The finder of the camera, from the driver that reads it out, else one that takes photos; and
    how long a picture of it may take. Raises DriverUnavailable, ConfigError."""
    name = rig.config.camera.driver
    if ("preview", name) not in list_known_drivers():
        return RawFinder(rig), max(_SILENT_S, rig.config.camera.fetch_timeout_s)
    finder: Preview = load_driver("preview", name).create(rig.context)
    return finder, _SILENT_S


def _pass_on(
    thread: FinderThread,
    made: LiveFrames,
    tell: Callable[[LiveFrame], object],
    cancelled: _Asked,
    ended: _Asked,
) -> None:
    """Report each picture until the end. Raises what else ends it."""
    while not ended():
        if cancelled():
            raise _make_end()
        came = thread.take(_LOOK_S)
        if came is not None:
            tell(made.make(came[1], came[0]))
        elif thread.is_late:
            raise _make_lost()


def _make_dark(rig: Rig, thread: FinderThread | None) -> bool:
    """Make panels black first, then end the finder, then make all safe; returns whether that
    succeeded."""
    try:
        with rig.context.patience.deaf():
            rig.display.black()
    except Exception as err:  # it is asked again below
        logger.warning("panels not black error=%s", err)
    ended = thread is None or thread.end(_GRACE_S)
    rig.context.shared.held = None  # not before: a virtual camera may be at its last picture
    if thread is None or ended:
        return rig.make_safe()
    rig.look_at_finder = partial(thread.wait, rig.context.patience.look)
    logger.error(
        "the camera has not finished its last picture, or hangs: its live view is left behind"
    )
    return rig.make_safe_beside(_GRACE_S)


def _make_end() -> Cancelled:
    return Cancelled("the live view was ended", hint="both panels are black")


def _make_lost() -> DeviceLost:
    return DeviceLost(
        "the camera hangs in its live view", device="camera", hint="switch it off and on"
    )
