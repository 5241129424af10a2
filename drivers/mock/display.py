"""Two panels in lockstep, each with its own vblank, and with faults on request."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers.mock.bench import Bench
from pdcd.config import Config, PanelConfig
from pdcd.errors import Cancelled, ConfigError
from pdcd.interfaces import Clock, DisplayInfo, DriverContext, FrameLog, Frames

REPORT_S = 0.1
"""Time between progress reports and looks at `cancelled`."""

COMMIT_NS = 1000
"""From both panels having shown a frame until the next is handed over."""


class MockDisplay:
    """Shows frames at the vblanks of two panels; a frame is committed when both showed the last.

    So the slower panel throttles both, as one page flip over two outputs does, and unequal refresh
    rates slip and now and then cost a refresh. Faults of [display.faults] are counted in refreshes
    of each shot. Timestamps are exact; the panels' skew comes on top of them, in the optics.
    Does not model tearing.
    """

    maturity = "stable"

    def __init__(self, bench: Bench, clock: Clock, config: Config) -> None:
        self._bench = bench
        self._clock = clock
        self._config = config
        self._rng = np.random.default_rng([config.camera.seed, 3])
        self._frames: Frames | None = None

    @classmethod
    def create(cls, context: DriverContext) -> MockDisplay:
        """The panels of this rig's bench."""
        return cls(Bench.of(context), context.clock, context.config)

    def connect(self) -> DisplayInfo:
        """Black on return."""
        self.black()
        projector, mask = self._config.projector, self._config.mask
        return DisplayInfo(
            projector.size_px,
            mask.size_px,
            min(projector.refresh_hz, mask.refresh_hz),
            {"projector": "mock projector", "mask": "mock mask"},
        )

    def load(self, frames: Frames) -> None:
        """Check that the code cells fit the panels, and keep them."""
        for name, panel in (("projector", self._config.projector), ("mask", self._config.mask)):
            width, height = panel.size_px
            if frames.grid[0] > height or frames.grid[1] > width:
                raise ConfigError(
                    f"{frames.grid[0]} x {frames.grid[1]} cells do not fit {height} x {width} px",
                    device=name,
                    hint="use a coarser grid",
                )
        if frames.grid != self._bench.scene.grid:
            raise ConfigError(
                f"frames of {frames.grid} cells for a scene of {self._bench.scene.grid}",
                device="display",
                hint="the code grid must be the scene's",
            )
        self._frames = frames

    def black(self) -> None:
        """Both panels black."""
        self._bench.panels_black = True

    def show(self, frames: Frames) -> None:
        """Hold the first refresh."""
        self.load(frames)
        self._bench.panels_black = False

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        """Show all loaded frames, then black; the bench keeps what was shown."""
        frames = self._frames
        if frames is None:
            raise ConfigError("no frames are loaded", device="display", hint="call load first")
        log = self._timing(len(frames))
        self._bench.panels_black = False
        try:
            self._wait(log, progress, cancelled)
        finally:
            self.black()
        self._bench.frames, self._bench.log = frames, log
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
        report_ns = round(REPORT_S * 1e9)
        last_ns = int(log.primal_ns[0]) if len(log) else 0
        lost = np.cumsum(log.missed)
        for row, at_ns in enumerate(log.primal_ns.tolist()):
            self._clock.sleep_until_ns(at_ns)
            if at_ns - last_ns >= report_ns or row == 0:
                last_ns = at_ns
                progress(row, len(log), int(lost[row]))
                if cancelled():
                    raise Cancelled("cancelled while the codes were shown", device="display")
        self._clock.sleep_until_ns(int(log.end_ns.max()))
        progress(len(log), len(log), int(lost[-1]) if len(log) else 0)

    def _timing(self, count: int) -> FrameLog:
        """When each refresh reaches each panel, with the configured faults."""
        faults = self._config.display.faults
        panels = (self._config.projector, self._config.mask)
        flips = np.empty((2, count + 1), dtype=np.int64)
        late = {int(row): by for row, by in faults.late.items()}
        period_ns = 1e9 / min(p.refresh_hz for p in panels)
        commit_ns = self._clock.now_ns()
        for row in range(count + 1):  # one more: the black that ends the last refresh
            commit_ns += round(late.get(row, 0) * period_ns)
            for side, panel in enumerate(panels):
                flips[side, row] = _next_vblank_ns(panel, commit_ns)
            commit_ns = int(flips[:, row].max()) + COMMIT_NS
        missed = self._missed(flips)[:count]
        shown = np.stack([np.arange(count, dtype=np.int32)] * 2)
        for row in faults.dropped:
            _keep_previous(shown, (0, 1), row, missed)
        for row in faults.stale_projector:
            _keep_previous(shown, (0,), row, missed)
        for row in faults.stale_mask:
            _keep_previous(shown, (1,), row, missed)
        for side, panel in enumerate(panels):
            wobble = self._rng.standard_normal(count + 1) * panel.jitter_s * 1e9
            flips[side] = np.maximum.accumulate(flips[side] + np.rint(wobble).astype(np.int64))
        return FrameLog(
            primal_shown=shown[0],
            dual_shown=shown[1],
            primal_ns=flips[0, :count],
            dual_ns=flips[1, :count],
            end_ns=flips[:, count].copy(),
            missed=missed,
            source="mock",
            verified=True,
        )

    def _missed(self, flips: NDArray[np.int64]) -> NDArray[np.int32]:
        """Vblanks that passed without a new frame, before each flip; the worse of both panels."""
        lost = np.zeros(flips.shape, dtype=np.int64)
        for side, panel in enumerate((self._config.projector, self._config.mask)):
            periods = np.diff(flips[side]) * panel.refresh_hz * 1e-9
            lost[side, 1:] = np.rint(periods).astype(np.int64) - 1
        return np.asarray(lost.max(axis=0), dtype=np.int32)


def _next_vblank_ns(panel: PanelConfig, at_ns: int) -> int:
    """First vblank of a panel at or after a time."""
    period_ns = 1e9 / panel.refresh_hz
    phase_ns = panel.phase_s * 1e9
    # A rounding error of the division must not push a vblank that is now to the next one.
    number = math.ceil((at_ns - phase_ns) / period_ns - 1e-6)
    return round(number * period_ns + phase_ns)


def _keep_previous(
    shown: NDArray[np.int32], sides: tuple[int, ...], row: int, missed: NDArray[np.int32]
) -> None:
    """Let the panels carry the row before through this one; counts as a miss."""
    if 0 < row < shown.shape[1]:
        for side in sides:
            shown[side, row] = shown[side, row - 1]
        missed[row] = max(int(missed[row]), 1)
