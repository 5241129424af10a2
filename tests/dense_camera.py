"""A camera that is not drawn on squared paper, worked out point by point and refresh by refresh.

Nothing of the program's optics is used: every sample of every quad is placed on the field by hand,
sees the mask and the projector there as the paper's geometry has them, and is summed up over the
refreshes of a frame log. The projector is perfect; the mask may answer slowly and leak.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pdcd.panels.frames import BLACK, WHITE, FrameLog, Frames
from pdcd.panels.map import Map
from pdcd.panels.patterns import Patterns, read_pattern_levels
from tests.oracles import GUARDS

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

REFRESH_NS = 16_666_667
SETTLE_NS = 50_000_000


@dataclass
class DenseCamera:
    """Looks at a scene of (rows, cols) cells.

    map : from quads to the field. frame : rows and columns of quads. samples : along a side of a
    quad. blur_quads : standard deviation of the lens's blur.
    """

    grid: tuple[int, int]
    frame: tuple[int, int]
    map: Map
    samples: int = 4
    blur_quads: float = 0.0
    points: Floats = field(init=False)

    def __post_init__(self) -> None:
        height, width = (side * self.samples for side in self.frame)
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        self.points = self.map.to_field(np.stack([x, y], axis=-1) / self.samples)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Samples on the field."""
        return np.asarray(((self.points >= 0.0) & (self.points < 1.0)).all(axis=-1))

    @property
    def cell(self) -> Indices:
        """Cell of the scene at every sample; 0 outside."""
        x, y = self.points[..., 0] * self.grid[1], self.points[..., 1] * self.grid[0]
        cell = np.floor(y) * self.grid[1] + np.floor(x)
        return np.where(self.inside, cell, 0.0).astype(np.int64)

    def quads(self, of_samples: Floats) -> Floats:
        """What the sensor makes of an image of samples."""
        seen = np.where(self.inside, of_samples, 0.0)
        if self.blur_quads:
            seen = ndimage.gaussian_filter(
                seen, self.blur_quads * self.samples, mode="nearest", truncate=6.0
            )
        height, width = self.frame
        blocks = seen.reshape(height, self.samples, width, self.samples)
        return np.asarray(blocks.mean(axis=(1, 3)))

    def photo(
        self,
        frames: Frames,
        log: FrameLog,
        direct: Floats,
        transport: Floats,
        *,
        texture: Floats | None = None,
        ways: Floats | None = None,
        tau_s: float = 0.0,
        leak: float = 0.0,
        offset_cells: tuple[float, float] = (0.0, 0.0),
    ) -> Floats:
        """Light of an exposure, (h, w), scene units times seconds.

        direct (N,), transport (N, N) without a diagonal; texture, of samples, multiplies both.
        ways : where else on the field each sample gets as much light from as shines there.
        tau_s, leak, offset_cells : time constant, black over white and misregistration of the mask.
        """
        cell, seen = self.cell, np.flatnonzero(self.inside)
        cell = cell.ravel()[seen]
        places = [_Places(self, frames, shift, offset_cells, seen, ways) for shift in range(4)]
        light, state = np.zeros(seen.size), np.full(seen.size, leak)
        ends = [*log.dual_ns[1:].tolist(), int(log.end_ns[1])]
        for row, (start, end) in enumerate(zip(log.dual_ns.tolist(), ends, strict=True)):
            seconds = (end - start) * 1e-9
            shown, lit = int(log.dual_shown[row]), int(log.primal_shown[row])
            target = leak + (1.0 - leak) * places[int(frames.shift[shown])].mask(shown)
            open_s = target * seconds
            if tau_s:
                fading = np.exp(-seconds / tau_s)
                open_s += (state - target) * tau_s * (1.0 - fading)
                state = target + (state - target) * fading
            if open_s.any():
                point, of_cells = places[int(frames.shift[lit])].projector(lit)
                light += open_s * (direct[cell] * point + (transport @ of_cells)[cell])
                if ways is not None:
                    light += open_s * places[int(frames.shift[lit])].wandered(lit)
        whole = np.zeros(self.inside.shape)
        whole.ravel()[seen] = light
        return self.quads(whole if texture is None else whole * texture)


class _Places:
    """Where samples lie on the patterns of a sub-shift."""

    def __init__(
        self,
        camera: DenseCamera,
        frames: Frames,
        shift: int,
        offset: tuple[float, float],
        seen: Indices,
        ways: Floats | None = None,
    ) -> None:
        self._frames, self._grid = frames, camera.grid
        rows, cols = camera.grid
        half = np.array([0.5 * (shift & 1), 0.5 * (shift >> 1)])
        at = camera.points.reshape(-1, 2)[seen] * (cols, rows)
        self._light = _index(at + half, frames.lattice)
        if ways is not None:
            sent = ways.reshape(-1, 2)[seen]
            self._sent = np.where(
                ((sent >= 0.0) & (sent < 1.0)).all(axis=-1),
                _index(sent * (cols, rows) + half, frames.lattice), -1,
            )  # fmt: skip
        behind = at + np.array([offset[1], offset[0]])
        self._white = ((behind >= 0.0) & (behind < (cols, rows))).all(axis=-1)
        code = behind + half
        self._code = _index(code, frames.lattice)
        guard = GUARDS.get(frames.window)
        if guard:
            part = code - np.floor(code)
            self._code[((part < guard) | (part >= 1.0 - guard)).any(axis=-1)] = -1
        parts = np.array([0.25, 0.75])
        across = (np.arange(cols)[:, None] + parts).ravel() + half[0]
        down = (np.arange(rows)[:, None] + parts).ravel() + half[1]
        self._quarters = _index(np.stack(np.meshgrid(across, down), axis=-1), frames.lattice)

    def mask(self, row: int) -> Floats:
        """How far the mask is asked to open at every sample."""
        index = int(self._frames.dual_index[row])
        if index in (BLACK, WHITE):
            return np.asarray(self._white * float(index == WHITE))
        return self._levels(self._frames.dual_patterns, index)[self._code]

    def projector(self, row: int) -> tuple[Floats | float, Floats]:
        """Light at every sample, and the mean over every cell of the scene."""
        index = int(self._frames.primal_index[row])
        if index in (BLACK, WHITE):
            level = float(index == WHITE)
            return level, np.full(self._grid[0] * self._grid[1], level)
        levels = self._levels(self._frames.primal_patterns, index)
        parts = levels[self._quarters].reshape(self._grid[0], 2, self._grid[1], 2)
        return levels[self._light], parts.mean(axis=(1, 3)).ravel()

    def wandered(self, row: int) -> Floats:
        """Light at every sample by its own way."""
        index = int(self._frames.primal_index[row])
        if index in (BLACK, WHITE):
            return np.where(self._sent >= 0, float(index == WHITE), 0.0)
        return self._levels(self._frames.primal_patterns, index)[self._sent]

    def _levels(self, patterns: Patterns, index: int) -> Floats:
        """Of all cells of a pattern, and 0 for what is beyond."""
        rows, cols = self._frames.lattice
        return np.append(read_pattern_levels(patterns, index, rows * cols), 0.0)


def _index(places: Floats, lattice: tuple[int, int]) -> Indices:
    """Cell of a pattern at places (..., 2) in cells; -1 beyond it."""
    col, row = np.floor(places[..., 0]), np.floor(places[..., 1])
    there = (col >= 0) & (row >= 0) & (col < lattice[1]) & (row < lattice[0])
    return np.where(there, row * lattice[1] + col, -1).astype(np.int64)


def on_time(frames: Frames, shift_s: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)) -> FrameLog:
    """The log of a display that misses nothing; refreshes of a sub-shift may last longer."""
    more = np.rint(np.array(shift_s) * 1e9).astype(np.int64)[frames.shift]
    flips = SETTLE_NS + np.append(0, np.cumsum(REFRESH_NS + more))
    rows = np.arange(len(frames), dtype=np.int32)
    none = np.zeros(len(frames), np.int32)
    return FrameLog(rows, rows, flips[:-1], flips[:-1], flips[[-1, -1]], none, "test", True)
