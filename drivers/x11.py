"""Two real panels on one X screen, shown by a process of their own (`pdcd.presenter`).

Never run on an optical bench: page flips, the panels' phase and the time sources that need a
graphics card have only been exercised on X servers without hardware.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from pdcd.config import Config
from pdcd.errors import ConfigError, DeviceLost
from pdcd.interfaces import Display, DisplayInfo, DriverContext, FrameLog, Frames
from pdcd.presenter.client import Log, Presenter, Rows
from pdcd.presenter.messages import Log as Column
from pdcd.presenter.messages import Open, Panel
from pdcd.presenter.options import Options

VERIFIED = ("present-complete",)
"""Time sources that prove presentation, where every frame was a page flip."""


class X11Display:
    """Projector and mask as windows of one X server.

    The display process is started by `connect`, and again by the next job after it has died.
    """

    maturity = "experimental"

    def __init__(self, config: Config, options: Options) -> None:
        projector, mask = config.projector, config.mask
        self._open = Open(
            options,
            Panel(projector.size_px, projector.refresh_hz),
            Panel(mask.size_px, mask.refresh_hz),
        )
        self._presenter: Presenter | None = None
        self._frames: Frames | None = None

    @classmethod
    def create(cls, context: DriverContext) -> X11Display:
        """Check the options; the panels are opened by `connect`."""
        config: Config = context.config
        try:
            options = msgspec.convert(config.display.options, Options)
        except msgspec.ValidationError as err:
            raise ConfigError(f"[display.options]: {err}", device="display") from err
        if config.rig.clock != "real":
            raise ConfigError(
                "real panels keep real time", device="display", hint='set rig.clock = "real"'
            )
        return cls(config, options)

    def connect(self) -> DisplayInfo:
        """Start the display process; both panels are black on return."""
        ready = self._alive().ready
        return DisplayInfo(
            self._open.projector.size_px,
            self._open.mask.size_px,
            ready.refresh_hz,
            ready.identity,
        )

    def load(self, frames: Frames) -> None:
        """Hand all patterns to the graphics card; nothing is shown yet."""
        self._frames = None
        self._alive().load(frames)
        self._frames = frames

    def black(self) -> None:
        """Both panels black; nothing to do while there are no windows."""
        if self._presenter is not None:
            self._presenter.black()

    def show(self, frames: Frames) -> None:
        """Hold the first refresh."""
        self.load(frames)
        self._alive().show(0)

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        """Show all loaded frames, then black."""
        frames, presenter = self._frames, self._presenter
        if frames is None:
            raise ConfigError("no frames are loaded", device="display", hint="call load first")
        if presenter is None or not presenter.alive:
            raise DeviceLost(
                "the display process has ended", device="display", hint="take the shot again"
            )
        count = len(frames)
        rows = np.arange(count, dtype=np.int32)
        log = presenter.play(rows, rows, lambda n, missed: progress(n, count, missed), cancelled)
        found = frame_log(rows, rows, log, presenter.ready.source)
        progress(count, count, int(found.missed.sum()))
        return found

    def disconnect(self) -> None:
        """Black, then end the display process."""
        if self._presenter is not None:
            presenter, self._presenter, self._frames = self._presenter, None, None
            presenter.close()

    def _alive(self) -> Presenter:
        if self._presenter is None or not self._presenter.alive:
            self.disconnect()
            self._presenter = Presenter(self._open)
        return self._presenter


def frame_log(primal: Rows, dual: Rows, log: Log, source: str) -> FrameLog:
    """The frame log of one pass.

    A row that came late had the one before it on the panels meanwhile. Both panels are taken to
    begin a row at the vblank that the source reports: which of two outputs is first is not known
    to it, and belongs in the panels' skew.
    """
    ns, missed = log[:, Column.NS], np.diff(log[:, Column.MSC], prepend=log[0, Column.MSC] - 1) - 1
    verified = source in VERIFIED and bool(log[:, Column.FLIPPED].all())
    return FrameLog(
        primal_shown=primal,
        dual_shown=dual,
        primal_ns=ns[:-1].copy(),
        dual_ns=ns[:-1].copy(),
        end_ns=np.array([ns[-1], ns[-1]]),
        missed=missed[:-1].astype(np.int32),
        source=source,
        verified=verified,
    )


def _conforms(driver: X11Display) -> Display:
    """Let the type checker compare the class with its Protocol."""
    return driver
