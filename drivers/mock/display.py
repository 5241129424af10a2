"""Two panels in lockstep, each with its own vblank, and with faults on request."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import FaultsConfig, PanelConfig
from pdcd.driver import (
    BLACK,
    Cancelled,
    Clock,
    Config,
    ConfigError,
    DisplayInfo,
    DriverContext,
    FrameLog,
    Frames,
    check_binary,
    check_fit,
    check_row_times,
    panels_of,
    play_all,
    streams,
)
from pdcd.probing.panel import vblank_lag_s

from .bench import MockBench, check_no_options

_REPORT_S = 0.1
"""Time between two progress reports, and two checks of `cancelled`."""

_COMMIT_NS = 1000
"""Time from when both panels have shown a frame until the next is handed over."""


class MockDisplay:
    """Shows frames at the vblanks of two panels; a frame is committed when both showed the last.

    So the slower panel throttles both, like one page flip over two outputs; unequal refresh rates
    slip and sometimes cost a refresh. Faults of [display.faults] are counted in refreshes of the
    video signal. Panels of 24 planes show the bits of a picture one after the other, and all of
    them again if no new picture came. Panels with times of rows (`display.row_times`) show rows
    from their first vblank on, each by its own clock. Timestamps are exact; the optics add the
    panels' skew. Tearing is not modelled.
    """

    maturity = "stable"

    def __init__(self, bench: MockBench, clock: Clock, config: Config) -> None:
        self._bench = bench
        self._clock = clock
        self._config = config
        self._panels = panels_of(config)
        self._rng = np.random.default_rng([config.camera.seed, 3])
        self._frames: Frames | None = None
        self._exposures = self._refreshes = self._rows = self._lost = 0

    @classmethod
    def create(cls, context: DriverContext) -> MockDisplay:
        """The panels of this rig's bench. Raises ConfigError if they are given options, or maps
        that cannot be used."""
        check_no_options(context.config.display.options, "display.options", "display")
        return cls(MockBench.of(context), context.clock, context.config)

    def connect(self) -> DisplayInfo:
        """Black on return."""
        self.black()
        projector, mask = self._config.projector, self._config.mask
        return DisplayInfo(
            projector.size_px,
            mask.size_px,
            min(projector.refresh_hz, mask.refresh_hz),
            {"projector": "mock projector", "mask": "mock mask"},
            self._mask_lag_s(),
            row_times=self._config.display.row_times,
        )

    @property
    def _true_panels(self) -> tuple[PanelConfig, PanelConfig]:
        """The true projector and mask."""
        return self._bench.true.projector, self._bench.true.mask

    def _mask_lag_s(self) -> float | None:
        """Phase and skew of the mask against the projector, its delay included."""
        projector, mask = self._config.projector, self._config.mask
        if projector.refresh_hz != mask.refresh_hz:
            return None  # it drifts
        delay_s = self._config.mask_delay_rows / self._config.row_hz
        # Vblanks are measured; the light's delay after them is only believed.
        apart = vblank_lag_s(self._bench.true.projector, self._bench.true.mask)
        return apart + mask.skew_s - projector.skew_s + delay_s

    def load(self, frames: Frames) -> None:
        """Keep the frames, after a check that every code cell has pixels on both panels."""
        if not self._config.display.row_times:
            check_row_times(frames)
        if self._config.display.planes_per_refresh > 1:
            check_binary(frames.primal_patterns, frames.dual_patterns)
        check_fit(frames, self._panels.projector)
        check_fit(frames, self._panels.mask)
        if not frames.of_pixels and frames.grid != self._bench.grid:
            raise ConfigError(
                f"frames of {frames.grid} cells for a bench of {self._bench.grid}",
                device="display",
                hint="the codes' grid must be that of the configuration",
            )
        self._frames = frames

    def black(self) -> None:
        """Both panels black."""
        self._bench.black(self._clock.now_ns())

    def show(self, frames: Frames) -> None:
        """Hold the first refresh."""
        self.load(frames)
        self._bench.lit()

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        """Show all loaded frames, then black; the bench keeps what was shown."""
        frames = self._frames
        if frames is None:
            raise ConfigError("no frames are loaded", device="display", hint="call load first")
        rig = self._config.rig
        self._exposures += 1
        self._refreshes = self._rows = self._lost = 0

        def once(rows: NDArray[np.int32]) -> FrameLog:
            log = self._pass(rows)
            self._bench.lit()
            try:
                self._wait(log, progress, cancelled)
                self._bench.black(int(log.end_ns.max()))
            finally:
                self.black()
            self._bench.frames, self._bench.log = frames, log
            return log

        log = play_all(
            once, frames, on_miss=rig.on_miss, rounds=rig.retries, row_hz=self._config.row_hz
        )
        self._bench.log, self._bench.whole = log, True
        return log

    def disconnect(self) -> None:
        """Black."""
        self.black()

    def _wait(
        self,
        log: FrameLog,
        progress: Callable[[int, int, int], None],
        cancelled: Callable[[], bool],
    ) -> None:
        """Let the clock reach each refresh; report and look for a cancel from time to time."""
        report_ns = round(_REPORT_S * 1e9)
        last_ns = int(log.primal_ns[0]) if len(log) else 0
        before, total = self._rows, self._rows + len(log)
        lost = self._lost + np.cumsum(log.missed)
        for row, at_ns in enumerate(log.primal_ns.tolist()):
            self._clock.sleep_until_ns(at_ns)
            if at_ns - last_ns >= report_ns or row == 0:
                last_ns = at_ns
                progress(before + row, total, int(lost[row]))
                if cancelled():
                    raise Cancelled("cancelled while the codes were shown", device="display")
        self._clock.sleep_until_ns(int(log.end_ns.max()))
        self._rows, self._lost = total, int(lost[-1]) if len(log) else self._lost
        progress(total, total, self._lost)

    def _pass(self, rows: NDArray[np.int32]) -> FrameLog:
        """Show rows of the frames once, with the configured faults; returns what was shown when."""
        asked = np.stack(streams(rows, self._config.mask_delay_rows))
        planes = self._config.display.planes_per_refresh
        count = -(-asked.shape[1] // planes)
        faults = self._faults(count)
        dark_s, delay_s = self._row_times(asked)
        if dark_s is None and delay_s is None:
            flips = self._flips(count, faults)
            missed = self._missed(flips)[:count]
        else:
            flips, missed = self._sequence(faults, dark_s, delay_s, count)
        sent = np.full((2, count * planes), BLACK, dtype=np.int32)
        sent[:, : asked.shape[1]] = asked
        shown = sent.reshape(2, count, planes).copy()
        for refresh in faults.dropped:
            _keep_previous(shown, (0, 1), refresh, missed)
        for refresh in faults.stale_projector:
            _keep_previous(shown, (0,), refresh, missed)
        for refresh in faults.stale_mask:
            _keep_previous(shown, (1,), refresh, missed)
        again = np.zeros(count, dtype=np.int64)
        if planes > 1:  # a DLP shows all bits again when no new picture came
            again = self._missed(flips)[1:].astype(np.int64)
        for side, panel in enumerate(self._true_panels):
            wobble = self._rng.standard_normal(count + 1) * panel.jitter_s * 1e9
            flips[side] = np.maximum.accumulate(flips[side] + np.rint(wobble).astype(np.int64))
        log = self._log(asked, sent.reshape(shown.shape), shown, flips, missed, again)
        return replace(log, dark_s=dark_s, delay_s=delay_s)

    def _row_times(
        self, asked: NDArray[np.int32]
    ) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
        """Dark time and delay of what is sent, row by row; None if the frames have none."""
        assert self._frames is not None  # noqa: S101
        rows = np.where(asked[0] == BLACK, asked[1], asked[0])
        times = self._frames.dark_s, self._frames.delay_s
        dark_s, delay_s = (None if of_row is None else of_row[rows] for of_row in times)
        return dark_s, delay_s

    def _sequence(
        self,
        faults: FaultsConfig,
        dark_s: NDArray[np.float64] | None,
        delay_s: NDArray[np.float64] | None,
        count: int,
    ) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """When each panel begins each row, and black after them, (2, count + 1), and the refreshes
        lost before each row. Rows follow the panel's own clock, not the vblanks."""
        missed = np.zeros(count, dtype=np.int32)
        for row, lost in faults.late.items():
            missed[int(row)] = lost
        dark = np.zeros(count) if dark_s is None else dark_s.copy()
        dark[-1:] = 0.0  # black ends the last row
        late = np.append(np.cumsum(missed), missed.sum())
        begin_ns = self._start_ns()
        flips = np.empty((2, count + 1), dtype=np.int64)
        for side, panel in enumerate(self._true_panels):
            since_s = late / panel.refresh_hz
            since_s[1:] += np.cumsum(1.0 / panel.refresh_hz + dark)
            if side == 1 and delay_s is not None:
                since_s += np.append(delay_s, delay_s[-1:])
            flips[side] = _next_vblank_ns(panel, begin_ns) + np.rint(1e9 * since_s).astype(np.int64)
        return flips, missed

    def _faults(self, count: int) -> FaultsConfig:
        """The faults of the next `count` refreshes, by their numbers in this pass."""
        given, first = self._config.display.faults, self._refreshes
        self._refreshes += count
        if given.exposures and self._exposures > given.exposures:
            return FaultsConfig()

        def now(refreshes: Iterable[int]) -> tuple[int, ...]:
            return tuple(n - first for n in refreshes if first <= n < first + count)

        late = {int(refresh): by for refresh, by in given.late.items()}
        return FaultsConfig(
            late={str(n): late[n + first] for n in now(late)},
            dropped=now(given.dropped),
            stale_mask=now(given.stale_mask),
            stale_projector=now(given.stale_projector),
        )

    def _flips(self, count: int, faults: FaultsConfig) -> NDArray[np.int64]:
        """Vblanks at which each panel takes each refresh, and black after them, (2, count + 1)."""
        panels = self._true_panels
        flips = np.empty((2, count + 1), dtype=np.int64)
        late = {int(row): by for row, by in faults.late.items()}
        period_ns = 1e9 / min(p.refresh_hz for p in panels)
        commit_ns = self._start_ns()
        for row in range(count + 1):  # one more: the black that ends the last refresh
            commit_ns += round(late.get(row, 0) * period_ns)
            for side, panel in enumerate(panels):
                flips[side, row] = _next_vblank_ns(panel, commit_ns)
            commit_ns = int(flips[:, row].max()) + _COMMIT_NS
        return flips

    def _start_ns(self) -> int:
        """When to hand over the first refresh, so that both panels take it at nearby vblanks."""
        projector, mask = self._config.projector, self._config.mask
        now_ns = self._clock.now_ns()
        apart_ns = round(vblank_lag_s(projector, mask) * 1e9)
        if projector.refresh_hz != mask.refresh_hz or apart_ns == 0:
            return now_ns
        period_ns = 1e9 / projector.refresh_hz
        lit_ns = _next_vblank_ns(projector, now_ns - min(0, apart_ns))
        return max(now_ns, lit_ns + max(0, apart_ns) - round(period_ns) + _COMMIT_NS)

    def _log(
        self,
        asked: NDArray[np.int32],
        sent: NDArray[np.int32],
        shown: NDArray[np.int32],
        flips: NDArray[np.int64],
        missed: NDArray[np.int32],
        again: NDArray[np.int64],
    ) -> FrameLog:
        """The log of refreshes (2, V, planes) as rows; a picture counts as often as it was
        shown."""
        count, planes = sent.shape[1:]
        spare = count * planes - asked.shape[1]  # unasked planes of the last picture
        number = np.repeat(np.arange(count), 1 + again)
        turn = np.arange(number.size) - np.repeat(np.cumsum(1 + again) - 1 - again, 1 + again)
        plane = np.array(self._config.display.starts)
        stamps, ends = [], []
        for side, panel in enumerate(self._true_panels):
            period_ns = 1e9 / panel.refresh_hz
            late_ns = np.rint((turn[:, None] + plane) * period_ns).astype(np.int64)
            at = (flips[side][number][:, None] + late_ns).ravel()
            last_ns = int(flips[side, count]) + round(plane[0] * period_ns)
            ends.append(int(at[at.size - spare]) if spare else last_ns)
            stamps.append(at[: at.size - spare])
        rows = stamps[0].size
        late = np.zeros((number.size, planes), dtype=np.int32)
        late[:, 0] = np.where(turn == 0, missed[number], 0)
        return FrameLog(
            primal_shown=shown[0][number].ravel()[:rows],
            dual_shown=shown[1][number].ravel()[:rows],
            primal_ns=stamps[0],
            dual_ns=stamps[1],
            end_ns=np.array(ends),
            missed=late.ravel()[:rows],
            source="mock",
            verified=True,
            primal_asked=sent[0][number].ravel()[:rows],
            dual_asked=sent[1][number].ravel()[:rows],
            mask_delay=self._config.mask_delay_rows,
        )

    def _missed(self, flips: NDArray[np.int64]) -> NDArray[np.int32]:
        """Vblanks that passed without a new frame, before each flip; the worse of both panels."""
        lost = np.zeros(flips.shape, dtype=np.int64)
        for side, panel in enumerate(self._true_panels):
            periods = np.diff(flips[side]) * panel.refresh_hz * 1e-9
            lost[side, 1:] = np.rint(periods).astype(np.int64) - 1
        return np.asarray(lost.max(axis=0), dtype=np.int32)


def _next_vblank_ns(panel: PanelConfig, at_ns: int) -> int:
    """First vblank of a panel at or after a time."""
    period_ns = 1e9 / panel.refresh_hz
    phase_ns = panel.phase_s * 1e9
    # A rounding error of the division must not move a vblank at `at_ns` to the next one.
    number = math.ceil((at_ns - phase_ns) / period_ns - 1e-6)
    return round(number * period_ns + phase_ns)


def _keep_previous(
    shown: NDArray[np.int32], sides: tuple[int, ...], refresh: int, missed: NDArray[np.int32]
) -> None:
    """Let the panels show the previous refresh for this one, too; it counts as missed."""
    if 0 < refresh < shown.shape[1]:
        for side in sides:
            shown[side, refresh] = shown[side, refresh - 1]
        missed[refresh] = max(int(missed[refresh]), 1)
