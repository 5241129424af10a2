"""Moves a shutter while the panels show their frames, at the display's signs of progress.

One thread calls all devices, and a display keeps it while it plays. So the shutter is moved when
the display reports its progress.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pdcd.bench.devices import Clock, Shutter, ShutterTiming
from pdcd.errors import ExposureError, PdcdError
from pdcd.protocol.events import Emit, ShutterClosed, ShutterOpen

_EARLY_NS = 150_000_000
"""A call waits for the shutter's closing from so long before it: the next call might come too
late."""


@dataclass
class MovingShutter:
    """To be called as the `progress` of `Display.play`; it passes the call on.

    cancelled : whether the job is to end. open_ns, close_ns : when the shutter was surely open, and
        surely closed; None before that. failure : the error in moving it. It must not be raised
        through a display that plays: `over` makes the display end, and `ended` raises.
    """

    shutter: Shutter
    clock: Clock
    when: ShutterTiming
    shot: str
    notify: Emit
    progress: Callable[[int, int, int], None]
    cancelled: Callable[[], bool]
    failure: PdcdError | None = None
    open_ns: int | None = None
    close_ns: int | None = None

    def __call__(self, frame: int, frames: int, missed: int) -> None:
        """Open or close the shutter when it is time; closing may wait for `_EARLY_NS`."""
        self.progress(frame, frames, missed)
        if self.failure is not None:
            return
        try:
            self._move(frame)
        except PdcdError as err:
            self.failure = err

    def over(self) -> bool:
        """Whether the display is to end; to be passed to `Display.play` as `cancelled`."""
        return self.failure is not None or self.cancelled()

    def _move(self, frame: int) -> None:
        if self.open_ns is None:
            if frame >= self.when.after:
                self.open_ns = self.shutter.open()
                self.notify(ShutterOpen(shot=self.shot, t_mono_ns=self.open_ns))
            return
        due_ns = self.open_ns + round(self.when.open_s * 1e9)
        if self.close_ns is None and self.clock.now_ns() >= due_ns - _EARLY_NS:
            self.clock.sleep_until_ns(due_ns)
            self.close_ns = self.shutter.close()
            self.notify(ShutterClosed(shot=self.shot, t_mono_ns=self.close_ns))

    def ended(self) -> tuple[int, int]:
        """`open_ns` and `close_ns`, once the frames are over.

        Raises `failure`, and ExposureError when the frames ended before the shutter had closed; the
        shutter is closed then, too.
        """
        if self.failure is not None:
            raise self.failure
        if self.open_ns is None or self.close_ns is None:
            self.shutter.close()
            raise ExposureError(
                "the pictures ended before the shutter had closed",
                device="shutter",
                hint="see that the display tells of its progress ten times a second",
            )
        return self.open_ns, self.close_ns
