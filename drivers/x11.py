"""Two real panels on one X screen, shown by a process of their own (`pdcd.presenter`).

Never run on an optical bench: page flips, the panels' phase and the time sources that need a
graphics card have only been exercised on X servers without hardware.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pdcd.bench.devices import SharedState
from pdcd.driver import (
    BLACK,
    Config,
    ConfigError,
    DeviceLost,
    Display,
    DisplayInfo,
    DriverContext,
    FrameLog,
    Frames,
    check_binary,
    check_row_times,
    play_all,
    streams,
)
from pdcd.panels.pixels import Recorder
from pdcd.presenter.client import DisplayProcess, Log, RowNumbers, make_open_request
from pdcd.presenter.messages import Column, Open, Ready
from pdcd.presenter.options import VERIFIED


class X11Display:
    """Projector and mask as windows of one X server.

    The display process is started by `connect`, and again by the next job after it has died.
    """

    maturity = "experimental"

    def __init__(
        self,
        config: Config,
        request: Open,
        shared: SharedState,
        alive: Callable[[], object] = lambda: None,
        look: Callable[[], object] | None = None,
    ) -> None:
        self._open = request
        self._config = config
        self._shared = shared
        self._alive, self._look = alive, look
        self._planes = config.display.planes_per_refresh
        self._exposures = 0
        self._presenter: DisplayProcess | None = None
        self._frames: Frames | None = None

    @classmethod
    def create(cls, context: DriverContext) -> X11Display:
        """Check the options; the panels are opened by `connect`."""
        config = context.config
        request = make_open_request(config)
        if request.options.grab_px and config.display.planes_per_refresh > 1:
            raise ConfigError(
                "pictures of several planes are not taken apart again",
                device="display",
                hint="leave grab_px out, or set planes_per_refresh = 1",
            )
        return cls(config, request, context.shared, context.alive, context.patience.look)

    def connect(self) -> DisplayInfo:
        """Start the display process; both panels are black on return."""
        ready = self._running().ready
        return DisplayInfo(
            self._open.projector.size_px,
            self._open.mask.size_px,
            ready.refresh_hz,
            ready.identity,
            self._mask_lag_s(ready),
            warnings=ready.warnings,
        )

    def _mask_lag_s(self, ready: Ready) -> float | None:
        """Lag of the mask behind the projector: measured phase, configured skews and delay."""
        if ready.lag_s is None:
            return None
        config = self._config
        skew_s = config.mask.skew_s - config.projector.skew_s
        return ready.lag_s + skew_s + config.mask_delay_rows / config.row_hz

    def load(self, frames: Frames) -> None:
        """Hand all patterns to the graphics card; nothing is shown yet."""
        self._frames = None
        check_row_times(frames)
        if self._planes > 1:
            check_binary(frames.primal_patterns, frames.dual_patterns)
        self._running().load(frames)
        self._frames = frames

    def black(self) -> None:
        """Both panels black; nothing to do while there are no windows."""
        if self._presenter is not None:
            self._presenter.black()

    def show(self, frames: Frames) -> None:
        """Show the first refresh, and hold it."""
        self.load(frames)
        self._running().show(0)

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
        config, rig = self._config, self._config.rig
        self._exposures += 1
        stalls = self._open.options.stall_exposures
        stalled = not stalls or self._exposures <= stalls
        shown, lost = 0, 0
        recorder = self._recorder()

        def once(rows: RowNumbers) -> FrameLog:
            nonlocal shown, lost
            primal, dual = streams(rows, config.mask_delay_rows)
            count, first = len(primal), shown * self._planes
            log = presenter.play(
                _pictures(primal, self._planes),
                _pictures(dual, self._planes),
                lambda n, missed: progress(
                    min(first + n * self._planes, first + count), first + count, lost + missed
                ),
                cancelled,
                abort=rig.on_miss == "abort" and has_several_codes(frames),
                stalls_from=shown if stalled else None,
            )
            found = self._build_log(primal, dual, log, presenter.ready)
            found = replace(found, mask_delay=config.mask_delay_rows)
            if recorder is not None:
                if shown:
                    recorder.black()  # the row that `joined` puts between two passes
                for pictures in zip(*presenter.pictures, strict=True):
                    recorder.add(*pictures)
            shown += len(log) - 1
            lost += int(found.missed.sum())
            progress(first + count, first + count, lost)
            return found

        log = play_all(once, frames, on_miss=rig.on_miss, rounds=rig.retries, row_hz=config.row_hz)
        if recorder is not None:
            self._shared.pixels = recorder.shown()
        return log

    def disconnect(self) -> None:
        """Black, then end the display process."""
        if self._presenter is not None:
            presenter, self._presenter, self._frames = self._presenter, None, None
            presenter.close()

    def _build_log(self, primal: RowNumbers, dual: RowNumbers, log: Log, ready: Ready) -> FrameLog:
        """The log of one pass."""
        return build_frame_log(primal, dual, log, ready, self._config.display.starts)

    def _recorder(self) -> Recorder | None:
        """The recorder of an exposure's pictures, with option `grab_px`."""
        self._shared.pixels = None
        sizes_px = self._config.projector.size_px, self._config.mask.size_px
        return Recorder(*sizes_px) if self._open.options.grab_px else None

    def _running(self) -> DisplayProcess:
        if self._presenter is None or not self._presenter.alive:
            self.disconnect()
            self._presenter = DisplayProcess(self._open, self._alive, self._look)
        return self._presenter


def has_several_codes(frames: Frames) -> bool:
    """Whether a refresh that lasts too long makes codes unequal: not if there is only one code."""
    lit = frames.dual_index != BLACK
    shift = np.where(frames.dual_index >= 0, frames.shift, 0)
    codes = np.stack([frames.primal_index, frames.dual_index, shift], axis=1)[lit]
    return len(np.unique(codes, axis=0)) > 1


def _pictures(rows: RowNumbers, planes: int) -> RowNumbers:
    """Rows as refreshes of `planes` planes, (refreshes, planes); black fills up the last one."""
    count = -(-rows.size // planes)
    found = np.full(count * planes, BLACK, dtype=np.int32)
    found[: rows.size] = rows
    return found.reshape(count, planes)


def build_frame_log(
    primal: RowNumbers,
    dual: RowNumbers,
    log: Log,
    ready: Ready,
    plane_starts: tuple[float, ...] = (0.0,),
) -> FrameLog:
    """The frame log of one pass.

    While a row was late, the panels still showed the one before it; a picture of 24 planes is then
    shown again, each plane for its part of the refresh. Both panels are taken to begin a row at the
    vblank that the source reports. The source does not know which of two outputs is first: that
    belongs in the panels' phase and skew. `plane_starts` says when the planes of a picture begin,
    as fractions of a refresh.
    """
    planes = len(plane_starts)
    ns = log[:, Column.NS]
    late = (np.diff(log[:, Column.MSC]) - 1).astype(np.int32)
    missed = np.append(np.zeros(1, dtype=np.int32), late[:-1])
    verified = ready.source in VERIFIED and bool(log[:, Column.FLIPPED].all())
    end_ns = int(ns[-1])
    asked = [primal, dual]
    starts = ns[:-1]
    if planes > 1:
        again = 1 + late.astype(np.int64)
        number = np.repeat(np.arange(late.size), again)
        turn = np.arange(number.size) - np.repeat(np.cumsum(again) - again, again)
        period_ns = 1e9 / ready.refresh_hz
        offsets_ns = (turn[:, None] + np.array(plane_starts)) * period_ns
        starts = (starts[number][:, None] + np.rint(offsets_ns).astype(np.int64)).ravel()
        # Vblank times jitter if there is no screen: planes must never run backwards.
        starts = np.maximum.accumulate(starts)
        first = np.zeros((number.size, planes), dtype=np.int32)
        first[:, 0] = np.where(turn == 0, missed[number], 0)
        spare = late.size * planes - primal.size
        rows = starts.size - spare
        end_ns = int(starts[rows]) if spare else end_ns + round(plane_starts[0] * period_ns)
        starts, missed = starts[:rows], first.ravel()[:rows]
        asked = [_pictures(side, planes)[number].ravel()[:rows] for side in asked]
    return FrameLog(
        primal_shown=asked[0],
        dual_shown=asked[1],
        primal_ns=starts.copy(),
        dual_ns=starts.copy(),
        end_ns=np.array([end_ns, end_ns]),
        missed=missed,
        source=ready.source,
        verified=verified,
        primal_asked=asked[0],
        dual_asked=asked[1],
    )


def _conforms(driver: X11Display) -> Display:
    """Let the type checker compare the class with its Protocol."""
    return driver
