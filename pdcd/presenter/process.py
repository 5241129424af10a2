"""The display process: opens the panels, answers its driver, goes black when the driver is gone."""

from __future__ import annotations

import logging
import os
import select
from collections.abc import Callable
from typing import Any

import glfw
import numpy as np
from numpy.typing import NDArray

from pdcd.child import LineClosedError, MessageLine, ignore_signals
from pdcd.errors import ConfigError, DeviceLost, PdcdError
from pdcd.panels.frames import BLACK, Frames
from pdcd.panels.map import PanelView
from pdcd.presenter import desktop, realtime
from pdcd.presenter.clocks import (
    Completions,
    FreeRunningSource,
    ProcessorClock,
    SwapReturns,
    TimeSource,
    Vblanks,
    measure_period_ns,
)
from pdcd.presenter.loop import Loop
from pdcd.presenter.messages import (
    REQUESTS,
    Black,
    DisplayReply,
    DisplayRequest,
    Done,
    Failed,
    Head,
    Load,
    Open,
    Play,
    Quit,
    Ready,
    Show,
    map_shared_arrays,
)
from pdcd.presenter.phase import VblankPhase, measure_vblank_phase
from pdcd.presenter.places import Places
from pdcd.presenter.windows import PanelWindows
from pdcd.presenter.xgrab import Grabs
from pdcd.presenter.xpresent import PresentEvents

logger = logging.getLogger(__name__)

_PROBES = 5
"""How many times all time sources are tried before an error says that none delivers."""
IDLE_S = 0.25
"""Seconds between two looks at its windows while the process waits."""
_HEADS = int(Head.SHOWN), int(Head.STOP), int(Head.SPOILT)
"""As plain numbers, as they are read after every refresh."""
SOURCES = ("present-complete", "present-msc", "swap", "clock")
"""Time sources from best to worst."""


class Presenter:
    """Both panels, from `Open` to the end of the process."""

    def __init__(self, request: Open, hung_up: Callable[[], bool], driver: int) -> None:
        """`driver`: file descriptor of the driver's line; `hung_up` says whether it was closed."""
        self._options = options = request.options
        self._hung_up = hung_up
        self._places = Places(options.display, request)
        self._news = select.poll()
        self._news.register(driver, select.POLLHUP)
        self._news.register(self._places.fileno(), select.POLLIN)
        name = self._places.name
        _start_glfw(name)
        places = self._places
        views = (
            PanelView("projector", request.projector.map), PanelView("mask", request.mask.map),
        )  # fmt: skip
        self._windows = PanelWindows(
            options.layout, places.screen_px, places.panels, views, request.plane_order
        )
        if desktop.is_software_renderer(self._windows.renderer) and not options.allow_software:
            raise ConfigError(
                f"the renderer is software ({self._windows.renderer})",
                device="display",
                hint="install the graphics card's driver, or set allow_software for a test",
            )
        realtime_note = realtime.raise_priority(options.realtime_priority)
        self._events = PresentEvents(name, self._windows.timed_window)
        nominal_ns = 1e9 / min(request.projector.refresh_hz, request.mask.refresh_hz)
        self._source, self._period_ns = self._find_source(nominal_ns)
        self._frames: Frames | None = None
        self._grabs = self._grabber(name, request)
        self._windows.black()
        phase = measure_vblank_phase(name, places.panels)
        self.ready = Ready(
            lag_s=None if phase is None or places.drifts else phase.lag_s,
            source=self._source.name,
            refresh_hz=1e9 / self._period_ns,
            identity={
                **self._places.identity,
                "layout": options.layout,
                "renderer": self._windows.renderer,
                "time source": self._source.name,
                "phase": _phase_text(phase),
                "realtime": realtime_note,
                "memory locked": realtime.lock_memory(),
            },
            warnings=places.warnings,
        )
        realtime.stop_garbage_collection()

    def load(self, message: Load, arrays: dict[str, NDArray[Any]]) -> None:
        """Take over patterns; the panels stay as they are. Raises what `Places.check` raises."""
        frames = Frames(**arrays, grid=message.grid, lattice=message.lattice, window=message.window)
        self._frames = None
        self._places.check(unheard=True)
        self._windows.load(frames)
        self._frames = frames

    def show(self, row: int) -> None:
        """Hold one refresh: a row, or the picture of planes that begins with it."""
        self._source.sync()
        planes, frames = self._windows.planes, self._frames
        rows = np.full((1, planes), row, dtype=np.int32)
        if frames is not None and len(frames) > 1:  # one row alone fills all planes of a picture
            rows[0] = np.arange(row, row + planes)
            rows[rows >= len(frames)] = BLACK
        self._windows.prepare(rows, rows)
        for _ in range(2):  # both buffers alike, so that nothing else can be shown
            self._windows.draw(0)
            self._source.put()
            self._source.shown()
        self._windows.settle()
        self._windows.check()

    def black(self) -> None:
        """Both panels black."""
        self._windows.black()

    def play(self, message: Play, arrays: dict[str, NDArray[Any]]) -> None:
        """Show the rows asked for; the log and how far it got are in the shared arrays."""
        options, frames = self._options, self._frames
        head, shown, stopped, spoilt = arrays["head"].data, *_HEADS
        if frames is None:
            raise ConfigError("no frames are loaded", device="display", hint="call load first")
        abort = message.abort
        hung_up, news = self._hung_up, self._news
        patience_s = 2.0 * options.hang_s

        grabs = self._grabs
        if grabs is not None:
            grabs.begin(arrays)

        def stop() -> bool:
            realtime.arm_dead_mans_switch(patience_s)
            if grabs is not None:
                grabs.take(head[shown] - 1)
            if head[stopped] or (abort and head[spoilt]):
                return True
            # One question to the kernel for both, as it costs more than everything else here.
            return bool(news.poll(0)) and (hung_up() or self._places.changed())

        stalls = options.stalls_ms if message.stalls else {}
        stalls_ns = {int(n): round(ms * 1e6) for n, ms in stalls.items()}
        windows, dual = self._windows, arrays["dual"]
        opens = (np.append(frames.dual_index, BLACK)[dual] != BLACK).any(axis=1).tolist()
        windows.prepare(arrays["primal"], dual)
        loop = Loop(self._source, windows.draw, opens, self._period_ns, stop, stalls_ns)
        realtime.arm_dead_mans_switch(patience_s)
        try:
            loop.run(arrays["log"], arrays["head"], int(head[Head.FIRST]))
        finally:
            realtime.arm_dead_mans_switch(0.0)
            self._windows.black()
        self._windows.check()
        self._places.check(unheard=True)

    def idle(self) -> None:
        """Look at windows and outputs while nothing is asked."""
        glfw.poll_events()
        self._places.check()

    def close(self) -> None:
        """Black, then close everything."""
        self._windows.black()
        self._events.close()
        self._windows.close()
        glfw.terminate()

    def _grabber(self, name: str, request: Open) -> Grabs | None:
        """What reads the screen for `grab_px`. Raises ConfigError where it would read too late."""
        if request.options.grab_px is None:
            return None
        if self._source.queues:
            raise ConfigError(
                f"with the time source {self._source.name} the screen may be a refresh ahead",
                device="display",
                hint='set time_source = "present-msc" for option grab_px',
            )
        sizes_px = request.projector.size_px, request.mask.size_px
        projector, mask = zip(request.options.grab_px, sizes_px, strict=True)
        return Grabs(
            name, ((*projector[0], *projector[1]), (*mask[0], *mask[1])), self._windows.settle
        )

    def _find_source(self, nominal_ns: float) -> tuple[TimeSource, float]:
        """The best time source that delivers, and its period in ns.

        If none delivers, the machine may have been busy for a moment, so all are tried again.
        Raises DeviceLost when none delivers in the end.
        """
        windows, events = self._windows, self._events

        def make(name: str) -> TimeSource:
            if name == "present-complete":
                return Completions(events, windows.swap)
            if name == "present-msc":
                return Vblanks(events, windows.swap, windows.finish, nominal_ns)
            if name == "swap":
                return SwapReturns(windows.swap, windows.finish, nominal_ns)
            if name == "free":
                return FreeRunningSource(windows.swap, windows.finish)
            return ProcessorClock(windows.swap, windows.finish, nominal_ns)

        asked = self._options.time_source
        names = SOURCES if asked == "auto" else (asked,)
        for name in names * _PROBES:
            source = make(name)
            if name == "free":
                return source, nominal_ns
            period_ns = measure_period_ns(source, windows.draw_black, nominal_ns)
            if period_ns is not None:
                return source, period_ns
        raise DeviceLost(
            f"no vblank at {1e9 / nominal_ns:.3f} Hz from the time source {asked!r}",
            device="display",
            hint='check refresh_hz, or take time_source = "auto"',
        )


def serve_display(line: MessageLine[DisplayRequest]) -> None:
    """Answer requests until `Quit` or until the other end is gone; then go black."""
    gone = select.poll()
    gone.register(line, select.POLLHUP)

    def hung_up() -> bool:
        return bool(gone.poll(0))

    presenter: Presenter | None = None
    try:
        while True:
            while not line.wait(IDLE_S):
                if presenter is not None:
                    presenter.idle()
            message, fd = line.receive_with_fd()
            try:
                if isinstance(message, Open):
                    presenter = Presenter(message, hung_up, line.fileno())
                    line.send(presenter.ready)
                    continue
                if presenter is None:
                    raise DeviceLost("the panels are not open", device="display")
                _answer(presenter, message, fd)
            except ConfigError as err:
                line.send(_failed(err, alive=presenter is not None))
                if presenter is None:
                    return
                continue
            finally:
                if fd is not None:
                    os.close(fd)
            line.send(Done())
            if isinstance(message, Quit):
                return
    except LineClosedError:
        return
    finally:
        if presenter is not None:
            presenter.close()


def _answer(presenter: Presenter, message: DisplayRequest, fd: int | None) -> None:
    if isinstance(message, Load) and fd is not None:
        presenter.load(message, map_shared_arrays(fd, message.slots))
    elif isinstance(message, Play) and fd is not None:
        presenter.play(message, map_shared_arrays(fd, message.slots))
    elif isinstance(message, Show):
        presenter.show(message.row)
    elif isinstance(message, Black | Quit):
        presenter.black()


def run_display_process(fd: int) -> int:
    """Run the process on one end of a line; its exit status."""
    ignore_signals()
    line = MessageLine.at(fd, REQUESTS)
    try:
        serve_display(line)
    except PdcdError as err:
        return _report(line, _failed(err, alive=False))
    except Exception as err:
        logger.exception("presenter failed")
        return _report(line, Failed("device_lost", f"{type(err).__name__}: {err}", None, False))
    return 0


def _failed(err: PdcdError, *, alive: bool) -> Failed:
    where = "" if err.device in (None, "display") else f"{err.device}: "
    return Failed(err.kind, where + err.message, err.hint, alive)


def _report(line: MessageLine[DisplayRequest], message: DisplayReply) -> int:
    try:
        line.send(message)
    except LineClosedError:
        logger.warning("nobody is left to be told: %s", message)
    return 1


def _phase_text(phase: VblankPhase | None) -> str:
    if phase is None:
        return "not measured: no vblanks of two screens"
    projector, mask = (f"{1.0 / period_s:.3f} Hz" for period_s in phase.period_s)
    return f"projector {projector}, mask {mask}, mask later by {phase.lag_s * 1e3:.2f} ms"


def _start_glfw(display: str) -> None:
    """Open the library on a display. Raises DeviceLost when that fails."""
    os.environ["DISPLAY"] = display
    glfw.ERROR_REPORTING = "raise"
    try:
        glfw.init()
    except glfw.GLFWError as err:
        raise DeviceLost(
            f"cannot open the display {display!r}: {err}",
            device="display",
            hint="start the panels' X server (pdcd-x.service) or set DISPLAY",
        ) from err
