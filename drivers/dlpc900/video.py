"""One DMD on a video signal: set up over USB so that it shows each picture's 24 bits in turn.

Commands and their order are those of TI's guide: video mode, until the signal is locked, then
video-pattern mode, then a table of one entry a bit. If anything goes wrong, the device shows the
plane without light that `DmdPanel` loads, which needs no signal. `dlpc350` has the differences for
a DLPC350.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import NamedTuple, Protocol

from pdcd.driver import ConfigError, DeviceLost, Patience, PdcdError, SyncError

from .commands import (
    START,
    STOP,
    VIDEO,
    VIDEO_PATTERN,
    Command,
    Hardware,
    Main,
    pack_entry,
    pack_table,
)
from .device import PLANES
from .link import DeviceLink

LOCK_S, READY_S, _CHANGE_S, _PAUSE_S = 5.0, 3.0, 0.3, 0.02
"""Longest time until a signal is locked; longest time for anything else, on top of the guide's time
for a change of mode; that time; pause until the device is asked again."""
_CLOCKS_OFF = 2e-3
"""How much shorter a picture may be by the device's clock than measured, as a share."""
SIGNAL_HINT = (
    "check the video cable and that the mode is the mirrors' own; TI's program says whether the "
    "board's receiver is switched to that input"
)


class PlaneTimes(NamedTuple):
    """How long each of 24 planes is lit, and all mirrors dark after it."""

    exposure_us: int
    dark_us: int

    @property
    def plane_us(self) -> int:
        """From one plane to the next."""
        return self.exposure_us + self.dark_us


def divide_picture(
    refresh_hz: float, dark_us: int, least_us: int, *, black_us: int = 105, least_dark_us: int = 0
) -> PlaneTimes:
    """The longest equal planes that fit a picture.

    least_us : the shortest exposure. black_us : from the last plane until a picture may begin.
    least_dark_us : the shortest dark time other than 0. Raises ConfigError for planes that no
    device can show.
    """
    if 0 < dark_us < least_dark_us:
        raise ConfigError(
            f"mirrors are dark for {least_dark_us} us or not at all, not for {dark_us} us",
            device="display",
            hint=f"set dlpc.dark_us to 0, or to {least_dark_us} or more",
        )
    plane_us = int((1e6 / refresh_hz * (1.0 - _CLOCKS_OFF) - black_us) // PLANES)
    if plane_us - dark_us < least_us:
        raise ConfigError(
            f"planes of {plane_us} us, {dark_us} us of them dark, are too short: the device lights "
            f"them for {least_us} us or more",
            device="display",
            hint="take a shorter dlpc.dark_us, or a slower mode",
        )
    return PlaneTimes(plane_us - dark_us, dark_us)


class VideoEntry(NamedTuple):
    """What one entry shows: a bit of the picture, for these times."""

    bit: int
    times: PlaneTimes


class BlackPanel(Protocol):
    """A device without a signal, which is black."""

    kind: str
    firmware: str
    least_us: int

    def take_over(self) -> None:
        """Make it black, and identify it."""

    def close(self) -> None:
        """Leave it as the options say, and let it go."""


class VideoDmd:
    """A DMD that shows the bits of a video signal once `follow` has returned, and is black before.

    make_panel : the same device in the mode in which it needs no signal, as if never seen before.
    options : LEDs, trigger bit and bit 7 of the first entry. Raises what `DeviceLink` does.
    black_us, least_dark_us : see `divide_picture`.
    """

    black_us, least_dark_us, mode = 105, 0, VIDEO_PATTERN
    """The guide's black pattern before an entry that waits; any dark time is allowed."""

    def __init__(
        self,
        link: DeviceLink,
        make_panel: Callable[[], BlackPanel],
        options: tuple[int, int, int],
        patience: Patience,
    ) -> None:
        self.link, self.role = link, link.role
        self.panel = make_panel()
        self.follows = False
        self._make_panel, self._options, self._patience = make_panel, options, patience
        self._status = Hardware(0)

    def make_black(self) -> None:
        """Show a plane without light, which needs no signal, from any state."""
        self.follows = False
        self.panel = self._make_panel()
        self.panel.take_over()

    def follow(self, entries: Sequence[VideoEntry]) -> None:
        """Show these bits of each picture. Raises DeviceLost if there is no signal, and the errors
        of refusals; the device is then black."""
        self.follows = False
        try:
            self._set_up(entries)
            self.check()
        except BaseException:
            with suppress(PdcdError), self._patience.deaf():
                self.make_black()
            raise
        self.follows = True

    def make_wedge(self, longest: PlaneTimes) -> list[VideoEntry]:
        """Entries that light each plane longer than the previous one; together they take no longer
        than 24 of the `longest`."""
        least_us = self.panel.least_us
        step_us = 2 * (longest.plane_us - least_us) // PLANES
        return [VideoEntry(n, PlaneTimes(least_us + n * step_us, 0)) for n in range(PLANES)]

    def check(self) -> None:
        """Raise SyncError if it does not follow the signal any more."""
        main = Main(self.link.ask(Command.MAIN)[0])
        mode = self.link.ask(Command.MODE)[:1]
        bad = self._read_hardware() & ~self._status
        what = None
        if not self._is_locked():
            what = "has no video signal"
        elif bad & (Hardware.ABORTED | Hardware.SEQUENCE_FAULT):
            what = f"gave up its sequence ({bad.name})"
        elif mode != bytes([self.mode]) or not main & Main.RUNNING:
            what = "does not show the planes of its signal any more"
        if what is not None:
            raise SyncError(what, device=self.role, hint=SIGNAL_HINT)

    def close(self) -> None:
        """Leave it as the options say, and let it go."""
        try:
            if not self.link.lost:
                self.make_black()
        finally:
            self.panel.close()

    def _set_up(self, entries: Sequence[VideoEntry]) -> None:
        link = self.link
        self._tell(Command.RUN, STOP)
        self._tell(Command.MODE, VIDEO)
        self._wait_until(self._is_locked, LOCK_S, "finds no video signal", SIGNAL_HINT)
        self._enter_mode(_CHANGE_S, "does not take the bits of its video signal", SIGNAL_HINT)
        led, trigger, waits = self._options
        for n, (bit, times) in enumerate(entries):
            ways = (waits if n == 0 else 0, led, trigger)
            link.tell(Command.ENTRY, pack_entry(n, times, (0, bit), ways))
        link.tell(Command.TABLE, pack_table(len(entries), 0))
        told = link.try_ask(Command.TABLE)
        if told is not None and told[:2] != len(entries).to_bytes(2, "little"):
            raise ConfigError(
                "did not take its table", device=self.role, hint="update its firmware"
            )
        self._status = self._read_hardware()
        self._tell(Command.RUN, START)
        running = partial(self._has, Main.RUNNING)
        self._wait_until(running, READY_S, "does not start its planes", SIGNAL_HINT)

    def _enter_mode(self, after_s: float, what: str, hint: str) -> None:
        """Enter its mode, and stop: it may have started something by itself. after_s : when it is
        first asked whether it is in the mode. what, hint : for the error if it never is."""
        self._tell(Command.MODE, self.mode)
        self._patience.sleep(after_s)
        self._wait_until(
            lambda: self.link.ask(Command.MODE)[:1] == bytes([self.mode]), READY_S, what, hint
        )
        self._tell(Command.RUN, STOP)

    def _tell(self, command: int, value: int) -> None:
        self.link.tell(command, bytes([value]))

    def _is_locked(self) -> bool:
        return self._has(Main.LOCKED)

    def _has(self, flag: Main) -> bool:
        return bool(Main(self.link.ask(Command.MAIN)[0]) & flag)

    def _read_hardware(self) -> Hardware:
        return Hardware(self.link.ask(Command.HARDWARE)[0])

    def _wait_until(self, done: Callable[[], bool], within_s: float, what: str, hint: str) -> None:
        over = DeviceLost(what, device=self.role, hint=hint)
        wait_until(self._patience, done, within_s, over)


def wait_until(
    patience: Patience, done: Callable[[], bool], within_s: float, over: DeviceLost
) -> None:
    """Ask again and again; raise `over` if that takes too long."""
    with patience.within(within_s, lambda: over):
        while not done():
            patience.sleep(_PAUSE_S)
