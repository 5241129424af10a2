"""The shutter on a serial port.

Never run on real hardware: the port's code is tested on pseudo-terminals and on a fake line; the
kernel's behaviour (pulse at open, HUPCL) is taken from its source. Not supported: boxes that only
send a pulse, or that toggle.
"""

from __future__ import annotations

import logging
import weakref
from collections.abc import Iterator
from contextlib import suppress

from pdcd.driver import (
    Clock,
    Config,
    DeviceLost,
    DriverContext,
    ExposureError,
    Finding,
    Patience,
    PdcdError,
)

from .look import inspect_port
from .options import LONGEST_ANSWER_S, SerialOptions, read_serial_options
from .port import Port
from .watchdog import Alarm, Guardian, Watchdog

logger = logging.getLogger(__name__)

_POLL_NS = 1_000_000
_MARGIN_S = 30.0
"""Time that an exposure may take beyond its limit before the watchdog ends it."""


class SerialShutter:
    """Holds a line, or makes a box hold it, while the exposure lasts.

    Without feedback the shutter counts as open, or closed, a lag and four jitters of [trigger]
    after the command. With feedback it counts as open when the feedback says so, and as closed a
    lag and four jitters after that: a flash contact opens when the blades start to close.
    """

    maturity = "experimental"

    def __init__(
        self,
        options: SerialOptions,
        config: Config,
        clock: Clock,
        patience: Patience | None = None,
    ) -> None:
        self._options = options
        self._clock = clock
        self._patience = patience or Patience(clock)
        self._sure_ns = config.trigger.sure_ns
        limit_s = options.limit_s or config.limits.max_exposure_s + _MARGIN_S
        self._limit_s = min(limit_s, LONGEST_ANSWER_S)
        self._longest_s = self._limit_s
        self._port: Port | None = None
        self._watchdog: Watchdog | None = None
        self._forgotten: weakref.finalize[..., SerialShutter] | None = None
        self._open = False

    @classmethod
    def create(cls, context: DriverContext) -> SerialShutter:
        """Check the options; the port is opened by `connect`."""
        config = context.config
        options = read_serial_options(config.trigger)
        if "://" not in options.port:
            context.require_real_time("port", "shutter")
        return cls(options, config, context.clock, context.patience)

    def look(self) -> Iterator[Finding]:
        """What `pdcd doctor trigger` can say before the port is opened."""
        return inspect_port(self._options.port)

    def connect(self) -> dict[str, str]:
        """Open the port if it is not open; the shutter is closed on return.

        Raises DeviceLost, ConfigError for a port without the line, ExposureError when the feedback
        says that the shutter stays open.
        """
        if self._port is not None:
            try:
                self.close()
            except DeviceLost:  # unplugged since; perhaps it is back under its name
                self._drop()
        if self._port is None:
            self._open_port()
        options = self._options
        detail = f"{options.open_hex} / {options.close_hex}"
        if options.release != "command":
            detail = "active low" if options.active_low else "active high"
        return {
            "model": "serial shutter",
            "port": options.port,
            "release": f"{options.release}, {detail}",
            "feedback": options.feedback,
            "watchdog": type(self._watchdog).__name__.lower(),
        }

    def expect_exposure(self, exposure_s: float, longest_s: float) -> None:
        """Let the watchdog end the next exposure after `longest_s`, not only at the overall
        limit."""
        self._longest_s = min(longest_s, self._limit_s)

    def open(self) -> int:
        """Start the exposure; the watchdog is armed first.

        Raises DeviceLost, and ExposureError when the box or the feedback does not confirm, or when
        the watchdog's time was over before the command was sent, as the daemon had been stopped.
        The line is then released again.
        """
        port, watchdog = self._port, self._watchdog
        if port is None or watchdog is None:
            raise DeviceLost("the port is not open", device="shutter", hint="connect first")
        longest_s, self._longest_s = self._longest_s, self._limit_s
        watchdog.arm(longest_s)
        self._open = True  # from here on it may be open
        try:
            _see_guarded(watchdog)
            port.drive(opened=True)
            _see_guarded(watchdog)
            if self._options.feedback != "none":
                return self._wait_for(port, opened=True)
            return self._settled_ns()
        except BaseException:
            with suppress(PdcdError), self._patience.deaf():
                self.close()
            raise

    def close(self) -> int:
        """End the exposure. A port that was never opened holds no line.

        Raises DeviceLost: the state of the shutter is then unknown. Raises ExposureError when the
        feedback says that it stays open, or when the watchdog had to end the exposure.
        """
        port, watchdog = self._port, self._watchdog
        if port is None or watchdog is None:
            return self._clock.now_ns()
        port.drive(opened=False)
        was_open, self._open = self._open, False
        ended = watchdog.disarm()
        if self._options.feedback != "none":
            self._wait_for(port, opened=False)
        if ended:
            raise ExposureError(
                f"the watchdog ended the exposure: {ended}",
                device="shutter",
                hint="the photo is cut short; the log says more, and limit_s sets the time",
            )
        return self._settled_ns() if was_open else self._clock.now_ns()

    def disconnect(self) -> None:
        """Close the shutter, then the port."""
        try:
            self.close()
        finally:
            self._drop()

    def _open_port(self) -> None:
        port = Port(self._options, self._patience.look)
        try:
            self._patience.sleep(self._options.ready_s)
            port.drive(opened=False)
            if self._options.feedback != "none":
                self._wait_for(port, opened=False)
            if port.fd is None:
                alarm = self._watchdog = Alarm(lambda: port.drive(opened=False))
                self._forgotten = weakref.finalize(self, _close_forgotten, port, alarm)
            else:
                self._watchdog = Guardian(port.fd, *port.release)
        except BaseException:
            port.close()
            raise
        self._port = port

    def _drop(self) -> None:
        """Forget the port, whatever state it is in. The watchdog goes first: it shares the port."""
        watchdog, port = self._watchdog, self._port
        self._watchdog = self._port = None
        self._open = False
        if self._forgotten is not None:
            self._forgotten.detach()
        try:
            if watchdog is not None:
                watchdog.stop()
        finally:
            if port is not None:
                port.close()

    def _settled_ns(self) -> int:
        sure_ns = self._clock.now_ns() + self._sure_ns
        self._patience.sleep_until_ns(sure_ns)
        return sure_ns

    def _wait_for(self, port: Port, *, opened: bool) -> int:
        """Wait until the feedback says `opened`; return the time at which it did."""
        until_ns = self._clock.now_ns() + round(self._options.answer_s * 1e9)
        while port.shutter_is_open() != opened:
            self._patience.look()
            now_ns = self._clock.now_ns()
            if now_ns >= until_ns:
                wanted = "open" if opened else "close"
                raise ExposureError(
                    f"the feedback on {self._options.feedback.upper()} does not say that the "
                    f"shutter did {wanted}, {self._options.answer_s:g} s after it was told to",
                    device="shutter",
                    hint="check cable, polarity, bulb mode, and that the camera is on",
                )
            self._clock.sleep_until_ns(now_ns + _POLL_NS)
        return self._clock.now_ns()


def _see_guarded(watchdog: Watchdog) -> None:
    """Raise ExposureError when the watchdog's time is over."""
    if ended := watchdog.ended():
        raise ExposureError(
            f"the shutter was not opened in the time that the watchdog has for it: {ended}",
            device="shutter",
            hint="was the daemon stopped, or the machine suspended? take the photo again",
        )


def _close_forgotten(port: Port, alarm: Alarm) -> None:
    """Close the shutter of a driver that is no longer referenced, also when the interpreter ends.
    For ports that no guardian can hold."""
    alarm.stop()
    try:
        port.drive(opened=False)
    except PdcdError as err:
        logger.critical("shutter may be open device=shutter error=%s", err)
    port.close()
