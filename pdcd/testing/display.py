"""The promises of a display."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from pdcd.bench.devices import DisplayInfo
from pdcd.capture.rig import Rig
from pdcd.codes.make import make_codes
from pdcd.errors import Cancelled, ConfigError
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.patterns import pack_bits
from pdcd.panels.schedule import build_frames
from pdcd.testing.promises import Promise
from pdcd.testing.rigs import RigContract

DISPLAY_SAYS = Promise(
    "`connect` returns a DisplayInfo: sizes in pixels, a refresh rate, words",
    "fill in both panels' width and height, the rate in Hz that was measured, and who they are",
)
DISPLAY_FIT = Promise(
    "`load` raises ConfigError for what a panel cannot show: more cells than pixels",
    "call check_fit with both panels in `load`",
)
DISPLAY_ROW_TIMES = Promise(
    "`load` raises ConfigError for rows with times of their own, unless DisplayInfo.row_times",
    "call check_row_times in `load`",
)
DISPLAY_LOG = Promise(
    "`play` returns a log with every row that was asked for, in order, by the rig's clock",
    "log a row for each refresh, with times in ns of context.clock, and when both went black",
)
DISPLAY_AGAIN = Promise(
    "one `load` serves several `play`", "keep the frames until the next `load` or `disconnect`"
)
DISPLAY_PROGRESS = Promise(
    "`progress` is told of from 0 to all rows, in order, and may take half a second",
    "call progress(row, rows, missed) ten times a second and at the end; show on meanwhile",
)
DISPLAY_CANCEL = Promise(
    "`play` asks `cancelled` ten times a second, and raises Cancelled when it is true",
    "ask between refreshes; when it is true go black and raise Cancelled",
)
DISPLAY_NOT_LOADED = Promise(
    "`play` without frames raises ConfigError", 'raise ConfigError("no frames are loaded")'
)
DISPLAY_BLACK_SAFE = Promise(
    "`black` is safe in every state, twice, before `connect` and after `disconnect`",
    "do nothing where no panel is open",
)
DISPLAY_BESIDE = Promise(
    "`black` may be called beside any other call, from another thread",
    "hold no lock while frames are shown that `black` needs too",
)
DISPLAY_DISCONNECT = Promise(
    "`disconnect` may be called twice, and `connect` after it",
    "forget the panels in `disconnect`, and do nothing where there are none",
)
DISPLAY_BLACK = Promise(
    "both panels are black when `connect`, `load`, `black`, `play` or `disconnect` return",
    "make them black in each of these, and when `play` is cancelled",
)
DISPLAY_SHOWS = Promise(
    "`show` holds the first row until `black` or `play`", "light both panels before it returns"
)

_CODES = 64
"""Enough for a second of refreshes at 60 Hz, in which `cancelled` is asked ten times."""
_ASKED_HZ = 5.0
"""How often `cancelled` is to be asked at least, with room for a busy machine."""
_PAUSE_S = 0.5
"""How long `progress` may take."""


class DisplayContract(RigContract):
    """Each promise of `pdcd.driver.Display`, as tests of one driver."""

    roles: ClassVar[tuple[str, ...]] = ("display",)

    def find_lit(self, rig: Rig) -> bool | None:
        """Whether any panel shows light now; None where that cannot be seen.

        To be overridden by whoever has panels that can be looked at.
        """
        return None

    def test_connect_says_what_it_is(self, rig: Rig) -> None:
        with DISPLAY_SAYS.keep():
            info = rig.display.connect()
            DISPLAY_SAYS.require(isinstance(info, DisplayInfo), repr(info))
            sizes = info.primal_size_px + info.dual_size_px
            lag_s = 0.0 if info.mask_lag_s is None else info.mask_lag_s
            numbers = len(sizes) == 4 and min(sizes) > 0 and info.refresh_hz > 0.0
            words = [*info.identity.values(), *info.warnings]
        known = numbers and bool(np.isfinite([info.refresh_hz, lag_s]).all())
        DISPLAY_SAYS.require(known and all(isinstance(word, str) for word in words), repr(info))

    def test_what_does_not_fit_is_refused(self, rig: Rig) -> None:
        info = rig.display.connect()
        width_px = max(info.primal_size_px[0], info.dual_size_px[0])
        fine = make_test_frames((1, 2 * width_px), 2)
        DISPLAY_FIT.require_error(ConfigError, lambda: rig.display.load(fine))

    def test_times_of_single_rows_are_refused_where_they_are_not_known(self, rig: Rig) -> None:
        if rig.display.connect().row_times:
            pytest.skip("it knows of times of single rows")
        frames = make_test_frames(rig.grid)
        dark = replace(frames, dark_s=np.full(len(frames), 0.01))
        DISPLAY_ROW_TIMES.require_error(ConfigError, lambda: rig.display.load(dark))

    def test_play_logs_every_row_in_order(self, rig: Rig) -> None:
        frames = make_test_frames(rig.grid)
        with DISPLAY_LOG.keep():
            rig.display.load(frames)
            before_ns = rig.clock.now_ns()
            log = rig.display.play(_ignore, _never)
            after_ns = rig.clock.now_ns()
        _check_log(log, frames)
        first_ns = min(log.primal_ns[0], log.dual_ns[0])
        DISPLAY_LOG.require(
            before_ns <= first_ns and log.end_ns.max() <= after_ns,
            f"{first_ns} to {log.end_ns.max()} of a call from {before_ns} to {after_ns}",
        )

    def test_a_load_serves_several_plays(self, rig: Rig) -> None:
        with DISPLAY_AGAIN.keep():
            rig.display.load(make_test_frames(rig.grid))
            first = rig.display.play(_ignore, _never)
            second = rig.display.play(_ignore, _never)
            DISPLAY_AGAIN.require(
                second.primal_ns[0] >= first.end_ns.max(), "the second began before the first ended"
            )

    def test_progress_ends_at_the_last_row(self, rig: Rig) -> None:
        told: list[tuple[int, int, int]] = []

        def listen(*progress: int) -> None:
            if not told:
                rig.clock.sleep_until_ns(rig.clock.now_ns() + round(_PAUSE_S * 1e9))
            told.append((progress[0], progress[1], progress[2]))

        frames = make_test_frames(rig.grid)
        with DISPLAY_PROGRESS.keep():
            rig.display.load(frames)
            rig.display.play(listen, _never)
        rows = [row for row, _, _ in told]
        whole = bool(told) and rows[0] == 0 and told[-1][:2] == (len(frames), len(frames))
        DISPLAY_PROGRESS.require(whole and rows == sorted(rows), told)

    def test_cancel_is_heard(self, rig: Rig) -> None:
        asked: list[int] = []

        def ask() -> bool:
            asked.append(rig.clock.now_ns())
            return False

        with DISPLAY_CANCEL.keep():
            rig.display.load(make_test_frames(rig.grid))
            log = rig.display.play(_ignore, ask)
        shown_s = 1e-9 * float(log.end_ns.max() - log.primal_ns[0])
        DISPLAY_CANCEL.require(
            len(asked) >= _ASKED_HZ * shown_s, f"{len(asked)} times in {shown_s:.3g} s"
        )
        DISPLAY_CANCEL.require_error(Cancelled, lambda: rig.display.play(_ignore, lambda: True))

    def test_play_without_load_is_refused(self, rig: Rig) -> None:
        rig.display.disconnect()
        rig.display.connect()
        DISPLAY_NOT_LOADED.require_error(ConfigError, lambda: rig.display.play(_ignore, _never))

    def test_black_is_safe_in_every_state(self, rig: Rig) -> None:
        with DISPLAY_BLACK_SAFE.keep():
            self.make_fresh(rig).black()
            rig.display.black()
            rig.display.show(make_test_frames(rig.grid))
            rig.display.black()
            rig.display.black()
            rig.display.disconnect()
            rig.display.black()

    def test_black_may_be_called_beside_play(self, rig: Rig) -> None:
        called: list[bool] = []

        def go_black_once() -> bool:
            if not called:
                called.append(True)
                DISPLAY_BESIDE.require_beside(rig.display.black)
            return len(called) > 0

        rig.display.load(make_test_frames(rig.grid))
        DISPLAY_BESIDE.require_error(Cancelled, lambda: rig.display.play(_ignore, go_black_once))

    def test_disconnect_twice_and_connect_again(self, rig: Rig) -> None:
        with DISPLAY_DISCONNECT.keep():
            rig.display.disconnect()
            rig.display.disconnect()
            rig.display.connect()

    def test_panels_are_as_black_as_it_says(self, rig: Rig) -> None:
        if self.find_lit(rig) is None:
            pytest.skip("no find_lit tells what panels show: override it to have that looked at")
        display, frames = rig.display, make_test_frames(rig.grid)

        def require_black(after: str) -> None:
            DISPLAY_BLACK.require(not self.find_lit(rig), f"light after {after}")

        require_black("connect")
        display.load(frames)
        require_black("load")
        display.show(frames)
        DISPLAY_SHOWS.require(self.find_lit(rig), "no light after show")
        display.black()
        require_black("black")
        display.play(_ignore, _never)
        require_black("play")
        with pytest.raises(Cancelled):
            display.play(_ignore, lambda: True)
        require_black("a play that was cancelled")
        display.show(frames)
        display.disconnect()
        require_black("show and disconnect")


def make_test_frames(grid: tuple[int, int], codes: int = _CODES) -> Frames:
    """Codes on both panels over cells, a refresh each with its guards."""
    made = make_codes("balanced", grid, codes, dual="complement")
    pairs = pack_bits(made.primal), pack_bits(made.dual)
    return build_frames(pairs, grid, window="whole", schedule="full", passes=1)


def _check_log(log: FrameLog, frames: Frames) -> None:
    rows = len(frames)
    asked = [np.unique(of[of >= 0]) for of in log.asked]
    DISPLAY_LOG.require(
        all(np.array_equal(of, np.arange(rows)) for of in asked),
        f"{len(log)} rows of {rows}: {asked}",
    )
    for name, times_ns in (("projector", log.primal_ns), ("mask", log.dual_ns)):
        whole = times_ns.dtype == np.int64 and np.all(np.diff(times_ns) > 0)
        DISPLAY_LOG.require(
            whole, f"{times_ns.dtype} times of the {name}, not all later: {times_ns}"
        )
    last_ns = np.array([log.primal_ns[-1], log.dual_ns[-1]])
    DISPLAY_LOG.require(
        np.all(log.end_ns > last_ns), f"black at {log.end_ns}, after rows at {last_ns}"
    )


def _ignore(*_: int) -> None:
    """Progress that nobody hears of."""


def _never() -> bool:
    return False
