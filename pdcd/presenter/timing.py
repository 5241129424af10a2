"""How well the panels of a rig keep time: many refreshes of random codes, with their times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from pdcd.extras import suggest_install
from pdcd.panels.frames import BLACK, Frames
from pdcd.panels.patterns import pack_bits
from pdcd.presenter.client import DisplayProcess, Log, make_open_request
from pdcd.presenter.messages import Column, Ready

_PATTERNS = 64
"""Different codes that are shown in turn."""
_QUANTILES = (50.0, 99.0, 100.0)
_INK, _DPI = "#1b6ca8", 110
"""Colour and resolution of the histogram, as in docs/plots."""


@dataclass(frozen=True)
class RefreshTiming:
    """Refreshes of one run; all arrays are (R,).

    interval_s : from each refresh to the next. missed : refreshes lost before each. late_s : from
    a refresh to the start of the next one's drawing. draw_s : from there until it was handed over.
    cpu_s : processor time of the loop's thread. ready : the display process' reply when it opened.
    first_draw_s : drawing time of the run's first refresh, which comes before these; one number.
    """

    ready: Ready
    interval_s: NDArray[np.float64]
    missed: NDArray[np.int64]
    late_s: NDArray[np.float64]
    draw_s: NDArray[np.float64]
    cpu_s: NDArray[np.float64]
    first_draw_s: float

    @classmethod
    def of(cls, log: Log, ready: Ready) -> RefreshTiming:
        """The times in a log."""
        ns, put_ns = log[:, Column.NS], log[1:, Column.PUT_NS]
        spans_ns = (
            np.diff(ns),
            put_ns - ns[:-1],
            log[1:, Column.SWAP_NS] - put_ns,
            np.diff(log[:, Column.CPU_NS]),
        )
        interval_s, late_s, draw_s, cpu_s = (1e-9 * ns.astype(np.float64) for ns in spans_ns)
        missed = np.diff(log[:, Column.MSC]) - 1
        first_s = 1e-9 * float(log[0, Column.SWAP_NS] - log[0, Column.PUT_NS])
        return cls(ready, interval_s, missed, late_s, draw_s, cpu_s, first_s)

    def table(self) -> list[tuple[str, float, float, float]]:
        """Name, median, 99th percentile and maximum of each time, in ms."""
        rows = (
            ("refresh to refresh", self.interval_s),
            ("vblank to drawing", self.late_s),
            ("drawing", self.draw_s),
            ("processor time", self.cpu_s),
        )
        found = []
        for name, seconds in rows:
            p50, p99, most = (float(q) * 1e3 for q in np.percentile(seconds, _QUANTILES))
            found.append((name, p50, p99, most))
        return found


def measure_refreshes(config: Config, refreshes: int) -> RefreshTiming:
    """Show random codes with guards for `refreshes` refreshes. Raises what the display raises."""
    presenter = DisplayProcess(make_open_request(config))
    try:
        planes = config.display.planes_per_refresh
        presenter.load(make_random_codes(config.code_grid()))
        rows = np.arange(refreshes * planes, dtype=np.int32) % (3 * _PATTERNS)
        sent = rows.reshape(refreshes, planes)
        log = presenter.play(sent, sent, lambda *_: None, lambda: False)
        return RefreshTiming.of(log, presenter.ready)
    finally:
        presenter.close()


def make_random_codes(grid: tuple[int, int]) -> Frames:
    """64 random codes and their complements, three refreshes each: [P P P] and [0 M 0]."""
    on = np.random.default_rng(0).random((_PATTERNS, grid[0] * grid[1])) < 0.5
    row = np.arange(3 * _PATTERNS)
    guard = row % 3 != 1
    index = (row // 3).astype(np.int32)
    return Frames(
        primal_patterns=pack_bits(on),
        dual_patterns=pack_bits(~on),
        primal_index=index,
        dual_index=np.where(guard, BLACK, index).astype(np.int32),
        shift=np.zeros(row.size, dtype=np.uint8),
        code=index,
        guard=guard,
        grid=grid,
        lattice=grid,
        window="whole",
    )


def draw_histogram(timing: RefreshTiming, path: Path) -> None:
    """Write the intervals and the processor time as a picture. Raises ConfigError."""
    try:
        from matplotlib.figure import Figure
    except ImportError as err:
        raise ConfigError(
            "a histogram needs matplotlib", hint=suggest_install("matplotlib")
        ) from err
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, seconds, label in (
        (left, timing.interval_s, "refresh to refresh / ms"),
        (right, timing.cpu_s, "processor time of a refresh / ms"),
    ):
        axes.hist(seconds * 1e3, bins=80, log=True, color=_INK)
        axes.set_xlabel(label, fontsize=9)
        axes.set_ylabel("refreshes", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3)
    figure.suptitle(
        f"{timing.interval_s.size} refreshes, {int(timing.missed.sum())} missed, "
        f"time source {timing.ready.source}",
        fontsize=10,
    )
    figure.savefig(path, dpi=_DPI)
