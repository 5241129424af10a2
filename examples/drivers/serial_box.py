"""A bulb release on a serial relay box: one byte opens the shutter, another closes it."""

from __future__ import annotations

import termios

import msgspec
import serial

from pdcd.driver import (
    Clock,
    DeviceLost,
    DriverContext,
    Shutter,
    TriggerConfig,
    read_options,
)


class Options(msgspec.Struct, frozen=True):
    """[trigger.options] of this driver."""

    port: str
    baud: int = 9600


class SerialBox:
    """Holds the relay while the exposure lasts. Not for boxes that only send a pulse."""

    maturity = "experimental"

    def __init__(self, options: Options, config: TriggerConfig, clock: Clock) -> None:
        self._options = options
        self._sure_ns = config.sure_ns  # the lag of the blades, measured once, and four jitters
        self._clock = clock
        self._port: serial.Serial | None = None

    @classmethod
    def create(cls, context: DriverContext) -> SerialBox:
        """Check the options; the port is opened by `connect`."""
        config = context.config.trigger
        options = read_options(
            config.options,
            Options,
            table="trigger.options",
            device="shutter",
            hint="port and baud are the options of the driver serial-box",
        )
        return cls(options, config, context.clock)

    def connect(self) -> dict[str, str]:
        """Open the port; the shutter is closed on return."""
        try:
            # A device node, or any URL of pyserial: tests give it the other side of a fake.
            self._port = serial.serial_for_url(
                self._options.port, self._options.baud, write_timeout=1.0
            )
        except OSError as err:  # SerialException is one
            raise DeviceLost(
                f"cannot open {self._options.port}", device="shutter", hint="is it plugged in?"
            ) from err
        self.close()
        return {"model": "serial box", "port": self._options.port}

    def open(self) -> int:
        """Start the exposure; returns the time by which the blades are surely open."""
        return self._send(b"1")

    def close(self) -> int:
        """End the exposure. Safe in every state: a port never opened holds no relay."""
        if self._port is None:
            return self._clock.now_ns()
        return self._send(b"0")

    def disconnect(self) -> None:
        """Close the shutter, then the port."""
        try:
            self.close()
        finally:
            if self._port is not None:
                self._port.close()
                self._port = None

    def _send(self, command: bytes) -> int:
        if self._port is None:
            raise DeviceLost("the port is not open", device="shutter", hint="connect first")
        try:
            self._port.write(command)
            self._port.flush()
        except (OSError, termios.error) as err:  # pyserial passes on what flush raises
            raise DeviceLost(
                "the box does not answer", device="shutter", hint="check cable and power"
            ) from err
        sure_ns = self._clock.now_ns() + self._sure_ns
        self._clock.sleep_until_ns(sure_ns)
        return sure_ns


def _conforms(driver: SerialBox) -> Shutter:
    """Let the type checker compare the class with its Protocol."""
    return driver
