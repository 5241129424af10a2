"""Two DMDs that show loaded planes by a clock of their own, started by one edge.

Written from TI's guides and tried on virtual devices, never on a DMD. Only a bench can show what
mirrors do between sequences, how late an edge acts, and how long a mirror takes to turn.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pdcd.driver import (
    Cancelled,
    ConfigError,
    Display,
    DisplayInfo,
    DriverContext,
    FrameLog,
    Frames,
    SyncError,
    check_fit,
    draw_plane_words,
    panels_of,
)

from .around import BLACK_PLANE, TableEntry
from .commands import MOST_DELAY_US, MOST_US
from .device import DmdPanel, apply_to_each
from .link import DeviceLink, FoundDevice, choose_device, list_devices
from .options import Dlpc900Options, read_dlpc900_options
from .playing import BlockWatch
from .sequence import (
    DmdSequence,
    count_fitting_codes,
    count_row_us,
    find_blocks,
    make_sequence,
)

logger = logging.getLogger(__name__)

_ROLES = ("projector", "mask")
_LOOK_S = 0.2
_OLD = 5
"""Firmware below this is older than the guides that this driver was written from."""


class Dlpc900Display:
    """Projector and mask, each a DMD of its own; the registry's name for it is `dlpc900`."""

    maturity = "experimental"

    def __init__(self, options: Dlpc900Options, context: DriverContext) -> None:
        self._options, self._context = options, context
        self._views = panels_of(context.config)
        self._row_us = count_row_us(context.config.row_hz)
        self._panels: list[DmdPanel] = []
        self._loaded: DmdSequence | None = None
        self._arms_at_black = self._armed = False
        self._turn = 0
        self._of_thread = threading.local()

    @classmethod
    def create(cls, context: DriverContext) -> Dlpc900Display:
        """Check the options; the devices are opened by `connect`."""
        options = read_dlpc900_options(context.config)
        if not options.in_process:
            context.require_real_time("DMD", "display")
        return cls(options, context)

    def connect(self) -> DisplayInfo:
        """Open both devices, or check that they still answer; black on return."""
        self._take_turn()
        self._loaded, self._arms_at_black = None, False
        self._opened()
        self.black()
        config = self._context.config
        warnings = []
        if self._options.start == "software":
            warnings.append(
                "the two DMDs are started one after the other, milliseconds apart, and photos of "
                'codes are wrong; connect a trigger and set start = "trigger" or "chain"'
            )
        identity = {}
        for panel in self._panels:
            identity[panel.role] = (
                f"{panel.kind} {panel.link.found.serial or panel.link.found.port}"
            )
            identity[f"firmware of the {panel.role}"] = panel.firmware or "unknown"
            if panel.firmware and int(panel.firmware.partition(".")[0]) < _OLD:
                warnings.append(
                    f"firmware {panel.firmware} of the {panel.role} is older than version {_OLD}, "
                    "which this driver was written for; update it"
                )
        return DisplayInfo(
            config.projector.size_px,
            config.mask.size_px,
            1e6 / self._row_us,
            identity,
            self._mask_lag_s(),
            row_times=True,
            waits_for_edge=self._options.start == "trigger",
            warnings=tuple(warnings),
        )

    def _mask_lag_s(self) -> float | None:
        """Lag of the mask that a calibration measured, if one edge starts both; None without
        one."""
        config = self._context.config
        skew_s = config.mask.skew_s - config.projector.skew_s
        if self._options.start == "software" or not skew_s:
            return None
        return skew_s + config.mask_delay_rows / config.row_hz

    def load(self, frames: Frames) -> None:
        """Send both panels their planes and tables; black on return.

        Raises ConfigError, before anything is sent, if the frames do not fit them.
        """
        loaded = self._loaded
        if loaded is not None and loaded.frames is frames:
            self._arms_at_black = False
            self.black()
            if self._loaded is loaded:  # both panels still have it
                self._arms_at_black = self._options.start == "trigger"
                return
        self._take_turn()
        self._loaded, self._arms_at_black = None, False
        for view in (self._views.projector, self._views.mask):
            check_fit(frames, view)
        panels = self._opened()
        sequence = make_sequence(frames, self._row_us, self._context.config.mask_delay_rows)
        sequence = self._cut(sequence)
        begun_ns, sent = self._context.clock.now_ns(), [0, 0]
        tables = [self._table(sequence, side, sequence.blocks[0]) for side in (0, 1)]

        def load_panel(side: int) -> None:
            planes, view = sequence.planes[side], (self._views.projector, self._views.mask)[side]

            def draw_keys(keys: Sequence[bytes]) -> NDArray[np.uint32]:
                return draw_plane_words(frames, view, planes.find_rows(keys))

            sent[side] = panels[side].load(tables[side], planes.keys, draw_keys)

        self._on_both(load_panel)
        took_s = 1e-9 * (self._context.clock.now_ns() - begun_ns)
        logger.info("loaded rows=%d pictures=%s seconds=%.3g", len(frames), sent, took_s)
        self._loaded, self._arms_at_black = sequence, self._options.start == "trigger"

    def black(self) -> None:
        """Both panels black; right after `load`, and with a trigger, they wait black for it."""
        self._take_turn()
        arms, self._arms_at_black, self._armed = self._arms_at_black, False, False
        with self._context.patience.deaf():
            if arms:
                self._arm(0)
            else:
                apply_to_each(list(self._panels), self._make_black)

    def show(self, frames: Frames) -> None:
        """Hold the first row until `black` or `play`."""
        self.hold(frames, rows=1)

    def hold(self, frames: Frames, rows: int | None = None) -> None:
        """Show the first `rows` rows, or all, over and over until `black` or `play`; each panel
        runs by itself."""
        self.load(frames)
        self._arms_at_black = False
        sequence = self._get_loaded()
        block = (0, sequence.asked.shape[1] if rows is None else rows)
        for side, panel in enumerate(self._panels):
            table = sequence.make_table(side, block, joined=True)
            panel.start(table, shown=None)

    def play(
        self, progress: Callable[[int, int, int], None], cancelled: Callable[[], bool]
    ) -> FrameLog:
        """Show all loaded rows once, then black. The log's times are computed from the start and
        the table's times. `verified` is False: only a camera that counts pulses of both panels can
        prove them."""
        self._take_turn()
        sequence = self._get_loaded()
        rows, starts = sequence.asked.shape[1], []

        def tell(first: int, row: int) -> None:
            progress(first + row, rows, 0)

        try:
            for number, block in enumerate(sequence.blocks):
                if cancelled():
                    raise Cancelled("cancelled before codes were shown", device="display")
                starts_ns = None if self._armed else self._arm(number)
                self._armed = False
                begins_us = sequence.begins_us(0, block), sequence.begins_us(1, block)
                watch = BlockWatch(
                    self._panels, self._context.clock, begins_us, starts_ns, self._options.start
                )
                starts.append(watch.wait(partial(tell, block[0]), cancelled))
        finally:
            self.black()
        progress(rows, rows, 0)
        return sequence.make_log(starts)

    def disconnect(self) -> None:
        """Black, then let both devices go."""
        self._take_turn()
        panels, self._panels, self._loaded = self._panels, [], None
        self._arms_at_black = self._armed = False
        with self._context.patience.deaf():
            apply_to_each(panels, DmdPanel.close)

    def _open(self) -> None:
        """Find both devices, and make them black."""
        options = self._options
        found = list_devices(self._context.usb_backend(options.usb))
        names = options.projector, options.mask
        chosen = [choose_device(found, *one) for one in zip(names, _ROLES, strict=True)]
        if chosen[0].port == chosen[1].port:
            raise ConfigError(
                f"projector and mask are both {chosen[0].name}",
                device="display",
                hint="name two devices; pdcd doctor display lists them",
            )
        panels: list[DmdPanel] = []
        try:
            for side, device in enumerate(chosen):
                panels.append(self._make_panel(side, device))
                panels[-1].take_over()
        except BaseException:
            for panel in panels:
                panel.link.close()
            raise
        self._panels = panels

    def _make_panel(self, side: int, device: FoundDevice) -> DmdPanel:
        config = self._context.config
        size_px = (config.projector, config.mask)[side].size_px
        link = DeviceLink(device, _ROLES[side], self._look)
        return DmdPanel(link, self._options, self._context.clock, size_px)

    def _reopen(self, panel: DmdPanel) -> None:
        """Open a panel again whose link was lost, and make it black."""
        self._loaded, self._arms_at_black, self._armed = None, False, False
        panel.link.close()
        options, side = self._options, _ROLES.index(panel.role)
        found = list_devices(self._context.usb_backend(options.usb))
        device = choose_device(found, (options.projector, options.mask)[side], panel.role)
        fresh = self._make_panel(side, device)
        self._panels[side] = fresh
        try:
            fresh.take_over()
        except BaseException:
            fresh.link.lost = True  # it may be anything by now
            raise

    def _opened(self) -> list[DmdPanel]:
        """Both panels, opened anew where one was lost."""
        if not self._panels:
            self._open()
        for panel in list(self._panels):
            if panel.link.lost:
                self._reopen(panel)
        return self._panels

    def _make_black(self, panel: DmdPanel) -> None:
        """Black from any state, by a new link if the old one was lost."""
        if panel.link.lost:
            self._reopen(panel)
        else:
            panel.black()

    def _get_loaded(self) -> DmdSequence:
        if self._loaded is None or not self._panels:
            raise ConfigError("no frames are loaded", device="display", hint="call load first")
        return self._loaded

    @property
    def least_us(self) -> int:
        """Shortest exposure, and shortest delay of a trigger, that both have."""
        return max(panel.least_us for panel in self._panels)

    def _cut(self, sequence: DmdSequence) -> DmdSequence:
        """The sequence, cut into blocks. Raises ConfigError if it does not fit the devices."""
        start = self._options.start
        most = min(panel.most_entries for panel in self._panels) - 1 - (start == "chain")
        planes = min(panel.most_planes for panel in self._panels)
        blocks, joined = find_blocks(sequence, most)
        needed = max(len(side.keys) for side in sequence.planes)
        if needed > planes or (len(blocks) > 1 and start == "trigger"):
            fits = count_fitting_codes(sequence, most, planes)
            rows = sequence.asked.shape[1]
            more = (
                ""
                if start != "trigger" or needed > planes
                else (', or set start = "chain", which shows tables one after the other')
            )
            raise ConfigError(
                f"{rows} rows of {needed} different planes do not fit a table of {most} entries "
                f"and {planes} planes: {fits} codes, each shown once, would",
                device="display",
                hint=f"take fewer codes, a shorter exposure or a schedule of fewer rows{more}",
            )
        sequence = replace(sequence, blocks=blocks, joined=joined)
        self._check_times(sequence)
        return sequence

    def _check_times(self, sequence: DmdSequence) -> None:
        """Raise ConfigError for times that the devices cannot keep."""
        least_us = self.least_us
        entries = [one for side in (0, 1) for block in sequence.blocks
                   for one in self._table(sequence, side, block)]  # fmt: skip
        shortest = min(one.exposure_us for one in entries)
        longest = max(max(one.exposure_us, one.dark_us) for one in entries)
        lead_us = max(max(sequence.lead_us(block)) for block in sequence.blocks)
        hint = None
        if shortest < least_us:
            what = f"rows of {shortest} us are shorter than the devices' {least_us} us"
            hint = f"set refresh_hz of both panels to {1e6 / least_us:.2f} or less"
        elif longest > MOST_US:
            what = f"rows, or dark times, of {1e-6 * longest:.3g} s are too long"
        elif lead_us + least_us > MOST_DELAY_US:
            what = f"a delay of the mask of {1e-3 * lead_us:.3g} ms is too long"
        elif lead_us and self._options.start == "software":
            what = "the mask cannot be delayed where each panel is started by itself"
        else:
            return
        raise ConfigError(what, device="display", hint=hint or "take a shorter one")

    def _table(self, sequence: DmdSequence, side: int, block: tuple[int, int]) -> list[TableEntry]:
        """The table of a panel for a block: rows, and a black plane at the end. If the projector
        starts the mask, its table also begins with a black plane, as the mask's trigger takes time.
        """
        table = sequence.make_table(side, block, joined=sequence.joined)
        if self._options.start == "chain" and side == 0:
            lead_us = self.least_us + sequence.lead_us(block)[0]
            table.insert(0, TableEntry(BLACK_PLANE, lead_us))
        return [*table, TableEntry(BLACK_PLANE, max(self._row_us, self.least_us))]

    def _arm(self, number: int) -> tuple[int, int] | None:
        """Start a block, or let it wait for its trigger. Returns when its first row began on
        projector and mask; None if that is not known yet."""
        sequence, start = self._get_loaded(), self._options.start
        block = sequence.blocks[number]
        leads_us, clock = sequence.lead_us(block), self._context.clock
        times = [0, 0]
        if start == "chain":
            self._panels[0].stop()  # each entry of its black is a trigger of the mask
        for side in (1, 0):  # the mask waits before the projector starts it
            panel, table = self._panels[side], self._table(sequence, side, block)
            waits = start == "trigger" or (start == "chain" and side == 1)
            delay_us = self.least_us + leads_us[side] if waits else None
            panel.start(table, shown=len(table), delay_us=delay_us)
            times[side] = clock.now_ns()
        if start == "trigger":
            self._armed = True
            return None
        if start == "chain":
            begun_ns = times[0] + 1000 * (self.least_us + leads_us[0])
            return begun_ns, begun_ns
        return times[0], times[1]

    def _on_both(self, work: Callable[[int], None]) -> None:
        """Do something to both panels, at the same time if they are real, as USB is slow."""
        if self._options.in_process:
            for side in range(len(self._panels)):
                work(side)
            return
        turn = self._turn

        def join_in(side: int) -> None:
            self._of_thread.turn, self._of_thread.helps = turn, True
            work(side)

        with ThreadPoolExecutor(len(self._panels)) as pool:
            left = {pool.submit(join_in, side) for side in range(len(self._panels))}
            try:
                while left:
                    done, left = wait(left, _LOOK_S, FIRST_EXCEPTION)
                    for one in done:
                        one.result()
                    self._look()
            except BaseException:
                self._take_turn()  # at which the other one gives up
                raise

    def _take_turn(self) -> None:
        """Take over for this thread: work that another thread does is given up."""
        self._turn += 1
        self._of_thread.turn, self._of_thread.helps = self._turn, False

    def _look(self) -> None:
        """Called before each command: raises an error if the work was ended, or another call has
        taken over."""
        if self._of_thread.turn != self._turn:
            raise SyncError(
                "the panels were made black meanwhile", device="display", hint="take it again"
            )
        if not self._of_thread.helps:
            self._context.patience.look()


def _conforms(driver: Dlpc900Display) -> Display:
    """Let the type checker compare the class with its Protocol."""
    return driver
