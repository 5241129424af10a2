"""One DMD on a video signal: set up over USB so that it shows each picture's 24 bits in turn.

Commands and their order are those of TI's guide: video mode, until the signal is locked, then
video-pattern mode, then a table of one entry a bit. Whatever goes wrong ends in the plane without
light that `DmdPanel` loads, which needs no signal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import NamedTuple

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
from .device import PLANES, DmdPanel
from .link import DeviceLink

_LOCK_S, _CHANGE_S, _READY_S, _PAUSE_S = 5.0, 0.3, 3.0, 0.02
"""How long a signal may take to be locked; what the guide has for the change of mode; how long the
device may take beyond that; until it is asked again."""
_BLACK_US = 105
"""The black pattern that the guide has before an entry that waits."""
_CLOCKS_OFF = 2e-3
"""By how much a picture may be shorter, by the device's clock, than it was measured to be."""
_SIGNAL_HINT = (
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


def divide_picture(refresh_hz: float, dark_us: int, least_us: int) -> PlaneTimes:
    """The longest equal planes that fit a picture. Raises ConfigError where they are too short."""
    plane_us = int((1e6 / refresh_hz * (1.0 - _CLOCKS_OFF) - _BLACK_US) // PLANES)
    if plane_us - dark_us < least_us:
        raise ConfigError(
            f"planes of {plane_us} us, {dark_us} us of them dark, are too short: the device lights "
            f"them for {least_us} us or more",
            device="display",
            hint="take a shorter dlpc.dark_us, or a slower mode",
        )
    return PlaneTimes(plane_us - dark_us, dark_us)


class VideoDmd:
    """A DMD that shows the bits of a video signal once `follow` has returned, and is black before.

    make_panel : the same device in the mode in which it needs no signal, as if never seen before.
    options : LEDs, trigger bit and bit 7 of the first entry. Raises what `DeviceLink` does.
    """

    def __init__(
        self,
        link: DeviceLink,
        make_panel: Callable[[], DmdPanel],
        options: tuple[int, int, int],
        patience: Patience,
    ) -> None:
        self.link, self.role = link, link.role
        self.panel = make_panel()
        self.follows = False
        self._make_panel, self._options, self._patience = make_panel, options, patience
        self._status = Hardware(0)

    def make_black(self) -> None:
        """Show a plane without light that needs no signal, from whatever state."""
        self.follows = False
        self.panel = self._make_panel()
        self.panel.take_over()

    def follow(self, times: Sequence[PlaneTimes]) -> None:
        """Show the 24 bits of each picture, for these times. Raises DeviceLost where there is no
        signal, and what a refusal is; the device is black then."""
        try:
            self._set_up(times)
        except BaseException:
            with suppress(PdcdError), self._patience.deaf():
                self.make_black()
            raise

    def check(self) -> None:
        """Raise SyncError where it does not follow the signal any more."""
        main = Main(self.link.ask(Command.MAIN)[0])
        mode = self.link.ask(Command.MODE)[:1]
        bad = self._read_hardware() & ~self._status
        what = None
        if not main & Main.LOCKED:
            what = "has no video signal"
        elif bad & (Hardware.ABORTED | Hardware.SEQUENCE_FAULT):
            what = f"gave up its sequence ({bad.name})"
        elif mode != bytes([VIDEO_PATTERN]) or not main & Main.RUNNING:
            what = "does not show the planes of its signal any more"
        if what is not None:
            raise SyncError(what, device=self.role, hint=_SIGNAL_HINT)

    def close(self) -> None:
        """Leave it as the options say, and let it go."""
        try:
            if not self.link.lost:
                self.make_black()
        finally:
            self.panel.close()

    def _set_up(self, times: Sequence[PlaneTimes]) -> None:
        link, self.follows = self.link, False
        self._tell(Command.RUN, STOP)
        self._tell(Command.MODE, VIDEO)
        locked = partial(self._has, Main.LOCKED)
        self._wait_until(locked, _LOCK_S, "finds no video signal", _SIGNAL_HINT)
        self._tell(Command.MODE, VIDEO_PATTERN)
        self._patience.sleep(_CHANGE_S)
        self._wait_until(
            lambda: link.ask(Command.MODE)[:1] == bytes([VIDEO_PATTERN]),
            _READY_S,
            "does not take the bits of its video signal",
            _SIGNAL_HINT,
        )
        self._tell(Command.RUN, STOP)  # may have started something by itself
        led, trigger, waits = self._options
        for bit, one in enumerate(times):
            ways = (waits if bit == 0 else 0, led, trigger)
            link.tell(
                Command.ENTRY, pack_entry(bit, (one.exposure_us, one.dark_us), (0, bit), ways)
            )
        link.tell(Command.TABLE, pack_table(len(times), 0))
        told = link.try_ask(Command.TABLE)
        if told is not None and told[:2] != len(times).to_bytes(2, "little"):
            raise ConfigError(
                "did not take its table", device=self.role, hint="update its firmware"
            )
        self._status = self._read_hardware()
        self._tell(Command.RUN, START)
        running = partial(self._has, Main.RUNNING)
        self._wait_until(running, _READY_S, "does not start its planes", _SIGNAL_HINT)
        self.check()
        self.follows = True

    def _tell(self, command: Command, value: int) -> None:
        self.link.tell(command, bytes([value]))

    def _has(self, flag: Main) -> bool:
        return bool(Main(self.link.ask(Command.MAIN)[0]) & flag)

    def _read_hardware(self) -> Hardware:
        return Hardware(self.link.ask(Command.HARDWARE)[0])

    def _wait_until(self, done: Callable[[], bool], within_s: float, what: str, hint: str) -> None:
        def over() -> DeviceLost:
            return DeviceLost(what, device=self.role, hint=hint)

        with self._patience.within(within_s, over):
            while not done():
                self._patience.sleep(_PAUSE_S)
