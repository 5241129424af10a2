"""The exposures that are measured: codes, refreshes, a frame log and panels, good or bad."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.codes.make import make_codes
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import pack_bits
from pdcd.panels.schedule import build_frames
from pdcd.probing.panel import PanelOptics

REFRESH_NS = 16_666_667
START_NS = 50_000_000
SETTLE_NS = 50_000_000
SEED = 1

GRIDS = ((12, 16), (24, 32), (48, 64), (96, 128))
"""Rows and columns of cells, from coarse to four times the paper's resolution."""

COUNTS = (8, 32, 128, 512, 1024)
"""Numbers of codes K."""


@dataclass(frozen=True)
class Bench:
    """How both panels behave; times in ns, the offset of the mask in cells (rows, cols)."""

    primal: PanelOptics
    dual: PanelOptics
    jitter_ns: int
    phase_ns: int
    offset_cells: tuple[float, float]


BENCHES = {
    "ideal": Bench(PanelOptics(), PanelOptics(), 0, 0, (0.0, 0.0)),
    "defects": Bench(
        PanelOptics(0.001, 0.003, 1 / 2000, 2_000_000),
        PanelOptics(0.012, 0.005, 1 / 300, 5_000_000),
        jitter_ns=400_000,
        phase_ns=1_234_567,
        offset_cells=(0.125, -0.25),
    ),
}
"""Perfect panels, and panels with unequal rise and fall, leak, skew, jitter and misregistration."""


@dataclass(frozen=True)
class Case:
    """One exposure, ready to be evaluated."""

    frames: Frames
    log: FrameLog
    bench: Bench
    close_ns: int


def make_case(grid: tuple[int, int], count: int, window: str, panels: str) -> Case:
    """A guarded sequence of `count` Hadamard codes for indirect light, shown once."""
    lattice = Lattice(grid, window)
    codes = make_codes("hadamard", lattice.shape, count, dual="complement", seed=SEED)
    frames = build_frames(
        (pack_bits(codes.primal), pack_bits(codes.dual)),
        grid,
        window=window,
        schedule="full",
        passes=1,
    )
    bench = BENCHES[panels]
    log = _log(len(frames), bench)
    return Case(frames, log, bench, int(log.end_ns.max()) + SETTLE_NS)


def _log(refreshes: int, bench: Bench) -> FrameLog:
    """Every refresh shown in its turn at 60 Hz, each panel with its own jitter."""
    rng = np.random.default_rng(SEED)
    at = START_NS + np.arange(refreshes + 1, dtype=np.int64) * REFRESH_NS
    jitter = rng.integers(-bench.jitter_ns, bench.jitter_ns + 1, size=(2, refreshes + 1))
    primal, dual = at + jitter[0], at + bench.phase_ns + jitter[1]
    rows = np.arange(refreshes, dtype=np.int32)
    return FrameLog(
        primal_shown=rows,
        dual_shown=rows,
        primal_ns=primal[:-1],
        dual_ns=dual[:-1],
        end_ns=np.array([primal[-1], dual[-1]]),
        missed=np.zeros(refreshes, dtype=np.int32),
        source="bench",
        verified=True,
    )
