"""Two virtual DLPC900s in front of the mock bench: what they really showed, as its photos see it.

The projector and the mask of a configuration are two devices on one USB, told apart by their serial
numbers. The camera's line says when the shutter of the bench is open, and is wired to TRIG_IN_1 of
both. Photos are computed from the planes that really stood, and when; what a driver reports about
that is ignored.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import BLACK, DriverContext, FrameLog, Frames, panels_of
from pdcd.panels.atoms import find_atoms
from pdcd.panels.frames import PIXEL_WINDOW
from pdcd.panels.map import PanelView

from ..mock.bench import MockBench
from .controller import VirtualDlpc900
from .model import VirtualDmdFault, VirtualDmdOptions, VirtualDmdTiming, choose_dmd_model
from .sequencer import PlayedContent, PlayedPlane
from .usb_bus import VirtualDmdBus

PROJECTOR_SERIAL, MASK_SERIAL = "VIRTUAL-P", "VIRTUAL-M"
_DECAYED = 40.0
"""Time constants after which nothing is left of what a panel showed."""

_Changes = Sequence[tuple[int, PlayedContent]]


def make_bench_bus(
    context: DriverContext,
    options: tuple[VirtualDmdOptions, VirtualDmdOptions] | None = None,
    faults: tuple[Sequence[VirtualDmdFault], Sequence[VirtualDmdFault]] = ((), ()),
) -> VirtualDmdBus[VirtualDlpc900]:
    """A pyusb backend with the projector and the mask of this rig's mock bench, in that order.

    Without options, they answer triggers as `phase_s` and `jitter_s` of the bench's truth say; its
    `skew_s` is added, as for all its panels. Raises ConfigError for an impossible bench.
    """
    bench, config = MockBench.of(context), context.config
    devices = []
    for side, panel in enumerate((bench.true.projector, bench.true.mask)):
        timing = VirtualDmdTiming(
            latency_ns=round(1e9 * panel.phase_s),
            jitter_ns=round(1e9 * panel.jitter_s),
            seed=2 * config.camera.seed + side,
        )
        given = VirtualDmdOptions(timing=timing) if options is None else options[side]
        serial, model = (PROJECTOR_SERIAL, MASK_SERIAL)[side], choose_dmd_model(panel.size_px)
        devices.append(VirtualDlpc900(context.clock, model, serial, given, faults[side]))
    bench.panels = DmdPanels(bench, devices[0], devices[1])
    return VirtualDmdBus(*devices)


class DmdPanels:
    """Both devices, with the interface that the bench expects of panels that are not its own."""

    def __init__(self, bench: MockBench, projector: VirtualDlpc900, mask: VirtualDlpc900) -> None:
        self._devices = projector, mask
        self._grid = bench.grid
        panels = panels_of(bench.config)
        self._views = panels.projector, panels.mask
        true = bench.true.projector, bench.true.mask
        slowest_s = max(time_s for panel in true for time_s in (panel.rise_s, panel.fall_s))
        latest_s = max(0.0, *(panel.skew_s for panel in true))
        self._before_ns = round(1e9 * (_DECAYED * slowest_s + latest_s))
        self._after_ns = round(1e9 * max(0.0, *(-panel.skew_s for panel in true)))
        self._held: tuple[list[PlayedContent], Frames | None] | None = None

    def expose(self, *, active: bool, at_ns: int) -> None:
        """Set the camera's line, which starts both."""
        for device in self._devices:
            device.drive_line(1, active, at_ns)

    def show_between(self, open_ns: int, close_ns: int) -> tuple[Frames, FrameLog]:
        """What stood while the shutter was open, one row for each change of either panel. Includes
        times before and after, as far as rise, fall and skew make them visible."""
        low_ns, high_ns = open_ns - self._before_ns, close_ns + self._after_ns
        sides = [_drop_black(device.list_changes(low_ns, high_ns)) for device in self._devices]
        count = max(map(len, sides))
        frames = self._make_frames([[content for _, content in side] for side in sides], count)
        start_ns = np.full((2, count), high_ns, dtype=np.int64)
        for side, changes in enumerate(sides):
            start_ns[side, : len(changes)] = [at_ns for at_ns, _ in changes]
        rows, end_ns = np.arange(count, dtype=np.int32), np.full(2, high_ns, dtype=np.int64)
        late = np.zeros(count, dtype=np.int32)
        log = FrameLog(rows, rows, start_ns[0], start_ns[1], end_ns, late, "mirrors", True)
        return frames, log

    def find_standing(self) -> Frames | None:
        """What stands now, in one row; None if that is black. Returns the same object as long as
        nothing changes."""
        contents = [device.find_content() for device in self._devices]
        if self._held is None or self._held[0] != contents:
            lit = any(content is not None for content in contents)
            frames = self._make_frames([[content] for content in contents], 1) if lit else None
            self._held = contents, frames
        return self._held[1]

    def count_pulses(self, side: int, low_ns: int, high_ns: int) -> int:
        """Count pulses at TRIG_OUT_2, as the bench's camera may."""
        pulses = self._devices[side].list_pulses(2, low_ns, high_ns)
        return sum(low_ns <= rise_ns < high_ns for rise_ns, _ in pulses)

    def _make_frames(self, sides: Sequence[Sequence[PlayedContent]], count: int) -> Frames:
        """Frames of cells if everything shown consists of whole cells of the bench's grid, as drawn
        on these panels; otherwise frames of the panels' own pixels."""
        numbered = [_number_planes(side, count) for side in sides]
        cells = [
            _read_cells(planes, view, self._grid)
            for (planes, _), view in zip(numbered, self._views, strict=True)
        ]
        whole = all(patterns is not None for patterns in cells)
        packed = [
            patterns if whole and patterns is not None else _read_pixels(planes)
            for patterns, (planes, _) in zip(cells, numbered, strict=True)
        ]
        none = np.zeros(count, dtype=np.int32)
        return Frames(
            primal_patterns=packed[0],
            dual_patterns=packed[1],
            primal_index=numbered[0][1],
            dual_index=numbered[1][1],
            shift=none.astype(np.uint8),
            code=none - 1,
            guard=none.astype(np.bool_),
            grid=self._grid,
            lattice=self._grid,
            window="whole" if whole else PIXEL_WINDOW,
        )


def _drop_black(changes: _Changes) -> _Changes:
    """Drop the changes before the first lit one: panels start out black."""
    lit = (place for place, (_, content) in enumerate(changes) if content is not None)
    return changes[next(lit, len(changes)) :]


def _number_planes(
    contents: Sequence[PlayedContent], count: int
) -> tuple[list[PlayedPlane], NDArray[np.int32]]:
    """Distinct planes, and the plane that each row shows, (count,); rows without one are BLACK."""
    known: dict[tuple[int, int], int] = {}
    planes: list[PlayedPlane] = []
    index = np.full(count, BLACK, dtype=np.int32)
    for row, content in enumerate(contents):
        if content is not None:
            number = known.setdefault((id(content.words), content.bit), len(planes))
            if number == len(planes):
                planes.append(content)
            index[row] = number
    return planes, index


def _read_cells(
    planes: Sequence[PlayedPlane], view: PanelView, grid: tuple[int, int]
) -> NDArray[np.uint8] | None:
    """Planes as packed patterns over cells, (P, ceil(N / 8)); None if any of them shows anything
    other than whole cells."""
    count = grid[0] * grid[1]
    atom = find_atoms(view, grid)
    cell = np.where(atom[..., 0] < 0, count, (atom[..., 1] >> 2) * grid[1] + (atom[..., 0] >> 2))
    flat = cell.ravel()
    pixel = np.full(count + 1, -1)
    pixel[flat[::-1]] = np.arange(flat.size)[::-1]
    bits: dict[int, int] = {}
    for plane in planes:
        bits[id(plane.words)] = bits.get(id(plane.words), 0) | 1 << plane.bit
    levels: dict[int, NDArray[np.uint32]] = {}
    for plane in planes:
        used = bits.pop(id(plane.words), 0)
        if not used:
            continue
        words = plane.words & np.uint32(used)
        found = np.where(pixel < 0, 0, words.ravel()[pixel]).astype(np.uint32)
        found[count] = 0  # beside the field all is black
        if not np.array_equal(found[cell], words):
            return None
        levels[id(plane.words)] = found[:count]
    return _pack([levels[id(plane.words)] >> plane.bit for plane in planes], count)


def _read_pixels(planes: Sequence[PlayedPlane]) -> NDArray[np.uint8]:
    """Planes as packed pictures of all pixels, (P, ceil(pixels / 8))."""
    return _pack([plane.words.ravel() >> plane.bit for plane in planes], 0)


def _pack(shown: Sequence[NDArray[np.integer[Any]]], count: int) -> NDArray[np.uint8]:
    """Pack the lowest bit of each value, plane by plane."""
    if not shown:
        return np.zeros((0, -(-count // 8)), dtype=np.uint8)
    return np.stack([np.packbits((values & 1).astype(np.uint8)) for values in shown])
