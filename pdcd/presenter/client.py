"""The driver's side of the display process: start it, ask it, watch it, and kill it if need be."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config
from pdcd.child import (
    LOOK_INTERVAL_S,
    LineClosedError,
    LineSilentError,
    make_module_command,
    start_child,
)
from pdcd.errors import Cancelled, ConfigError, DeviceLost, PdcdError, SyncError
from pdcd.extras import require_bench
from pdcd.panels.frames import BLACK, Frames
from pdcd.panels.pixels import PanelImage
from pdcd.presenter.messages import (
    HEAD_SIZE,
    LOG_COLUMNS,
    REPLIES,
    Black,
    DisplayReply,
    DisplayRequest,
    Failed,
    Head,
    Load,
    Open,
    PanelMode,
    Play,
    Quit,
    Ready,
    Show,
    copy_to_shared_memory,
)
from pdcd.presenter.options import read_x11_options
from pdcd.presenter.xconnection import close_x_connection, open_x_connection
from pdcd.presenter.xgrab import PICTURES, reserve_pictures

_START_S = 30.0
"""How long opening the panels may take: libraries, windows, and 30 frames for each time source."""
LOAD_S = 20.0
"""Longest time to hand over all patterns; 65536 codes take 0.1 s."""
_LEAD_IN = 2
"""Black refreshes before the first row, so that there is a vblank to time it against."""

RowNumbers = NDArray[np.int32]
Log = NDArray[np.int64]

_COMMAND = make_module_command("pdcd.presenter")
_lost = partial(DeviceLost, device="display")


def make_open_request(config: Config) -> Open:
    """The request to open a configuration's panels. Raises ConfigError."""
    options = read_x11_options(config)
    if config.rig.clock != "real":
        raise ConfigError(
            "real panels keep real time", device="display", hint='set rig.clock = "real"'
        )
    panels, display = panels_of(config), config.display
    return Open(
        options,
        PanelMode(panels.projector.map, config.projector.refresh_hz),
        PanelMode(panels.mask.map, config.mask.refresh_hz),
        display.plane_order if display.planes_per_refresh > 1 else None,
    )


class DisplayProcess:
    """One display process. Every method raises DeviceLost when the process is gone.

    `alive()` is called at least ten times a second while an answer is awaited. During the start,
    which takes seconds, `look()` is called instead; an exception from it ends the start.
    """

    def __init__(
        self,
        request: Open,
        alive: Callable[[], object] = lambda: None,
        look: Callable[[], object] | None = None,
    ) -> None:
        require_bench("glfw", "moderngl", "Xlib")
        self._child = start_child(_COMMAND, REPLIES, what="the display process", error=_lost)
        self._line = self._child.line
        self._pulse = look or alive
        self._display = request.options.display
        self._hang_s = request.options.hang_s
        self._grab = request.options.grab_px is not None
        self._sizes_px = request.projector.size_px, request.mask.size_px
        self.pictures: list[PanelImage] = []
        """With option `grab_px`: what projector and mask showed in the last pass."""
        try:
            reply = self._ask(request, _START_S)
        except BaseException:
            self.kill()
            raise
        if not isinstance(reply, Ready):
            self.kill()
            raise DeviceLost("the display process is out of step", device="display")
        self.ready, self._pulse = reply, alive

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self._child.running

    @property
    def pid(self) -> int:
        """Process number, for tests that end it."""
        return self._child.pid

    def load(self, frames: Frames) -> None:
        """Hand all patterns over; returns when the graphics card has them."""
        arrays = {
            name: np.ascontiguousarray(getattr(frames, name))
            for name in (
                "primal_patterns", "dual_patterns", "primal_index", "dual_index",
                "shift", "code", "guard",
            )
        }  # fmt: skip
        fd, slots, _ = copy_to_shared_memory(arrays)
        self._ask(Load(slots, frames.grid, frames.lattice, frames.window), LOAD_S, fd)

    def show(self, row: int) -> None:
        """Hold one row of the loaded frames."""
        self._ask(Show(row), self._hang_s + LOOK_INTERVAL_S)

    def play(
        self,
        primal: RowNumbers,
        dual: RowNumbers,
        progress: Callable[[int, int], None],
        cancelled: Callable[[], bool],
        *,
        abort: bool = False,
        stalls_from: int | None = 0,
    ) -> Log:
        """Show rows of the loaded frames side by side, -1 for black; both panels end black.

        Parameters
        ----------
        primal, dual : (refreshes, planes) int32
            Rows of the frames that each refresh carries: one, or the 24 of a picture.
        progress, cancelled : asked every 50 ms; progress(refreshes shown, refreshes missed).
        abort : end at once when a refresh with the mask open lasted too long.
        stalls_from : number of the first refresh for the stalls of the options; None: no stalls.

        Returns the log, (refreshes + 1, LOG_COLUMNS) int64: the last row is the black that ended
        them. Raises Cancelled; SyncError after `abort`; DeviceLost when the process hangs, after
        killing it.
        """
        planes, lead = primal.shape[1], _LEAD_IN
        before, after = np.full((lead, planes), BLACK, np.int32), np.full((1, planes), BLACK)
        count = lead + len(primal) + 1
        head = np.zeros(HEAD_SIZE, dtype=np.int64)
        head[Head.FIRST] = lead - (stalls_from or 0)
        fd, slots, arrays = copy_to_shared_memory(
            {
                "head": head,
                "primal": np.concatenate([before, primal, after], dtype=np.int32),
                "dual": np.concatenate([before, dual, after], dtype=np.int32),
                "log": np.zeros((count, LOG_COLUMNS), dtype=np.int64),
                **(reserve_pictures(count, self._sizes_px) if self._grab else {}),
            }
        )
        head = arrays["head"]
        self._send(Play(slots, abort=abort, stalls=stalls_from is not None), fd)
        try:
            self._watch(head, count, progress, cancelled)
        except BaseException:
            # `progress` or `cancelled` raised, or a signal came: go black now, not at the end.
            head[Head.STOP] = 1
            self._end_pass()
            raise
        self._reply()
        if head[Head.STOP]:
            raise Cancelled("cancelled while the codes were shown", device="display")
        if head[Head.SHOWN] != count:
            raise SyncError(
                "a code was shown for more than one refresh",
                device="display",
                hint="see what keeps the machine busy; rig.on_miss says what is done about it",
            )
        self.pictures = [arrays[n][lead : count - 1] for n in PICTURES if n in arrays]
        return np.array(arrays["log"][lead:])

    def black(self) -> None:
        """Both panels black on return, if need be by killing the process."""
        if self.alive:
            try:
                self._ask(Black(), self._hang_s)
                return
            except PdcdError:
                self.kill()
        # Its windows are gone with it, so the screen's own black shows, if there is still a screen.
        close_x_connection(open_x_connection(self._display))

    def close(self) -> None:
        """Black, then end the process."""
        if self.alive:
            try:
                self._ask(Quit(), self._hang_s)
                self._child.hang_up(self._hang_s)
            except PdcdError:
                self.kill()
        self.kill()

    def kill(self) -> None:
        """End the process at once; the server then removes its windows. Idempotent."""
        self._child.kill()

    def _watch(
        self,
        head: NDArray[Any],
        count: int,
        progress: Callable[[int, int], None],
        cancelled: Callable[[], bool],
    ) -> None:
        """Wait for the end of a pass; report its progress, and kill the process if it hangs."""
        seen, seen_s, asked_to_stop = -1, time.monotonic(), False
        while not self._line.wait(LOOK_INTERVAL_S):
            shown = int(head[Head.SHOWN])
            if shown != seen:
                seen, seen_s = shown, time.monotonic()
            elif time.monotonic() - seen_s > self._hang_s:
                self.kill()
                raise DeviceLost(
                    f"the display process hung for {self._hang_s:g} s and was killed",
                    device="display",
                    hint="see the X server's log; the next job starts another",
                )
            if not asked_to_stop:
                done = min(max(0, shown - _LEAD_IN), count - _LEAD_IN - 1)
                progress(done, int(head[Head.MISSED]))
                if cancelled():
                    head[Head.STOP] = 1
                    asked_to_stop = True

    def _end_pass(self) -> None:
        """Wait for the end of a pass that was told to stop, so that no later request receives its
        answer."""
        if not self.alive:
            return
        with suppress(PdcdError):  # the reason for stopping is the better error
            self._reply(self._hang_s)

    def _ask(self, message: DisplayRequest, within_s: float, fd: int | None = None) -> DisplayReply:
        self._send(message, fd)
        return self._reply(within_s)

    def _send(self, message: DisplayRequest, fd: int | None = None) -> None:
        try:
            self._line.send(message, fd)
        except LineClosedError:
            # Its last message can still be read: that is the better error.
            self._reply()
            raise self._gone() from None
        finally:
            if fd is not None:
                os.close(fd)

    def _reply(self, within_s: float | None = None) -> DisplayReply:
        """Take one reply; a failure becomes the error it stands for.

        If the wait is interrupted, by a signal, say, the process is killed: otherwise a later
        request would receive this answer.
        """
        try:
            reply = self._line.receive(within_s=within_s, alive=self._pulse)
        except LineClosedError:
            raise self._gone() from None
        except LineSilentError:
            self.kill()
            raise _lost(
                f"the display process did not answer within {within_s:g} s and was killed",
                hint="see the X server's log; the next job starts another",
            ) from None
        except BaseException:
            self.kill()
            raise
        if isinstance(reply, Failed):
            if not reply.alive:
                self.kill()
            kinds = {c.kind: c for c in (ConfigError, DeviceLost, SyncError)}
            raise kinds.get(reply.kind, DeviceLost)(
                reply.message, device="display", hint=reply.hint
            )
        return reply

    def _gone(self) -> DeviceLost:
        how = self._child.how_it_ended()
        self.kill()
        return _lost(
            f"the display process {how}",
            hint="see the log and the X server's; the next job starts another",
        )
