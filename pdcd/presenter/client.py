"""The driver's side of the display process: start it, ask it, watch it, and kill it if need be."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import Cancelled, ConfigError, DeviceLost, PdcdError, SyncError
from pdcd.panels.frames import BLACK, Frames
from pdcd.panels.pixels import Picture
from pdcd.presenter.grabs import PICTURES, room
from pdcd.presenter.memory import share
from pdcd.presenter.messages import (
    HEAD_SIZE,
    LOG_COLUMNS,
    Black,
    Channel,
    Failed,
    Head,
    Load,
    Open,
    Play,
    Quit,
    Ready,
    Reply,
    Request,
    Show,
    pair,
)
from pdcd.presenter.xconnection import connect, disconnect

START_S = 30.0
"""How long opening the panels may take: libraries, windows, and 30 frames for each time source."""
LOAD_S = 20.0
"""Bound of handing over all patterns, which takes 0.1 s for 65536 codes."""
LOOK_S = 0.05
"""Time between looks at progress and cancelling while rows are shown."""
LEAD_IN = 2
"""Black refreshes before the first row: they give it a vblank to be timed against."""

Rows = NDArray[np.int32]
Log = NDArray[np.int64]


class DisplayProcess:
    """One display process. Every method raises DeviceLost when it is gone, and then it is dead.

    `alive()` is called at least ten times a second while its answer is waited for.
    """

    def __init__(self, request: Open, alive: Callable[[], object] = lambda: None) -> None:
        mine, its = pair()
        # A session of its own: the terminal's Ctrl-C and hang-up are not for it.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "pdcd.presenter", str(its.fileno())],
            pass_fds=(its.fileno(),),
            start_new_session=True,
            stdin=subprocess.DEVNULL,
        )
        its.close()
        self._pulse = alive
        self._channel: Channel[Reply] = Channel(mine, Reply)
        self._poller = select.poll()
        self._poller.register(mine, select.POLLIN | select.POLLHUP)
        self._display = request.options.display
        self._hang_s = request.options.hang_s
        self._grab = request.options.grab_px is not None
        self._sizes_px = request.projector.size_px, request.mask.size_px
        self.pictures: list[Picture] = []
        """With option `grab_px`: what projector and mask showed in the last pass."""
        try:
            reply = self._ask(request, START_S)
        except BaseException:
            self.kill()
            raise
        if not isinstance(reply, Ready):
            self.kill()
            raise DeviceLost("the display process is out of step", device="display")
        self.ready = reply

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        """Process number, for tests that end it."""
        return self._process.pid

    def load(self, frames: Frames) -> None:
        """Hand all patterns over; returns when the graphics card has them."""
        arrays = {
            name: np.ascontiguousarray(getattr(frames, name))
            for name in (
                "primal_patterns", "dual_patterns", "primal_index", "dual_index",
                "shift", "code", "guard",
            )
        }  # fmt: skip
        fd, slots, _ = share(arrays)
        self._ask_with(fd, Load(slots, frames.grid, frames.lattice, frames.window), LOAD_S)

    def show(self, row: int) -> None:
        """Hold one row of the loaded frames."""
        self._ask(Show(row), self._hang_s + LOOK_S)

    def play(
        self,
        primal: Rows,
        dual: Rows,
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
        planes, lead = primal.shape[1], LEAD_IN
        before, after = np.full((lead, planes), BLACK, np.int32), np.full((1, planes), BLACK)
        count = lead + len(primal) + 1
        head = np.zeros(HEAD_SIZE, dtype=np.int64)
        head[Head.FIRST] = lead - (stalls_from or 0)
        fd, slots, arrays = share(
            {
                "head": head,
                "primal": np.concatenate([before, primal, after], dtype=np.int32),
                "dual": np.concatenate([before, dual, after], dtype=np.int32),
                "log": np.zeros((count, LOG_COLUMNS), dtype=np.int64),
                **(room(count, self._sizes_px) if self._grab else {}),
            }
        )
        head = arrays["head"]
        self._send(Play(slots, abort=abort, stalls=stalls_from is not None), fd)
        try:
            self._watch(head, count, progress, cancelled)
        except BaseException:
            # Whoever was told of the progress failed, or a signal came: black now, not in the end.
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
        # Its windows went with it, and the screen's own black shows; if there is still a screen.
        disconnect(connect(self._display))

    def close(self) -> None:
        """Black, then end the process."""
        if self.alive:
            try:
                self._ask(Quit(), self._hang_s)
                self._process.wait(self._hang_s)
            except (PdcdError, subprocess.TimeoutExpired):
                self.kill()
        self.kill()

    def kill(self) -> None:
        """End the process at once; the server then removes its windows. Idempotent."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._channel.sock.close()

    def _watch(
        self,
        head: NDArray[Any],
        count: int,
        progress: Callable[[int, int], None],
        cancelled: Callable[[], bool],
    ) -> None:
        """Wait for the end of a pass; tell how far it is, and see that it goes on."""
        seen, seen_s, asked_to_stop = -1, time.monotonic(), False
        while not self._poller.poll(LOOK_S * 1000):
            shown = int(head[Head.SHOWN])
            if shown != seen:
                seen, seen_s = shown, time.monotonic()
            elif time.monotonic() - seen_s > self._hang_s:
                self.kill()
                raise DeviceLost(
                    f"the display process hung for {self._hang_s:g} s and was killed",
                    device="display",
                    hint="see the X server's log; the next job starts it anew",
                )
            if not asked_to_stop:
                done = min(max(0, shown - LEAD_IN), count - LEAD_IN - 1)
                progress(done, int(head[Head.MISSED]))
                if cancelled():
                    head[Head.STOP] = 1
                    asked_to_stop = True

    def _end_pass(self) -> None:
        """Wait for the end of a pass that was told to stop, so that no later request takes its
        answer for its own."""
        if not self.alive:
            return
        if not self._answered(self._hang_s):
            self.kill()
            return
        with suppress(PdcdError):  # why the pass was told to stop is what counts
            self._reply()

    def _ask(self, message: Request, timeout_s: float) -> Reply:
        self._send(message)
        if not self._answered(timeout_s):
            self.kill()
            raise DeviceLost(
                f"the display process did not answer within {timeout_s:g} s and was killed",
                device="display",
                hint="see the X server's log; the next job starts it anew",
            )
        return self._reply()

    def _ask_with(self, fd: int, message: Request, timeout_s: float) -> None:
        self._send(message, fd)
        if not self._answered(timeout_s):
            self.kill()
            raise DeviceLost("the display process takes no patterns", device="display")
        self._reply()

    def _answered(self, within_s: float) -> bool:
        """Whether there is an answer, or an end, within that time.

        Where a signal breaks the wait off the process is killed: nobody is left for its answer,
        which a later request would take for its own.
        """
        until_s = time.monotonic() + within_s
        try:
            while not self._poller.poll(LOOK_S * 1000):
                self._pulse()
                if time.monotonic() > until_s:
                    return False
        except BaseException:
            self.kill()
            raise
        return True

    def _send(self, message: Request, fd: int | None = None) -> None:
        try:
            self._channel.send(message, fd)
        except OSError as err:
            if not self._poller.poll(0):
                raise self._gone() from err
            # What it said before it ended is still there to be read: that is the better error.
            self._reply()
            raise self._gone() from err
        finally:
            if fd is not None:
                os.close(fd)

    def _reply(self) -> Reply:
        """Take one reply; a failure becomes the error it stands for."""
        try:
            reply, _ = self._channel.receive()
        except (EOFError, OSError) as err:
            raise self._gone() from err
        if isinstance(reply, Failed):
            if not reply.alive:
                self.kill()
            kinds = {c.kind: c for c in (ConfigError, DeviceLost, SyncError)}
            raise kinds.get(reply.kind, DeviceLost)(
                reply.message, device="display", hint=reply.hint
            )
        return reply

    def _gone(self) -> DeviceLost:
        self.kill()
        status = self._process.returncode
        how = f"by signal {-status}" if status < 0 else f"with status {status}"
        return DeviceLost(
            f"the display process ended {how}",
            device="display",
            hint="see the log and the X server's; the next job starts it anew",
        )
