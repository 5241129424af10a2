"""[trigger.options] of the serial shutter."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from pdcd.driver import TriggerConfig, read_options

LONGEST_ANSWER_S = 1e6
"""Eleven days. No timer can be set to infinity, for one."""
_Seconds = Annotated[float, Meta(ge=0.0, le=3600.0)]


class SerialOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is wired to the port, and how long it may take to answer.

    Bytes are written in hexadecimal: ``"FF 01 01"``.
    """

    port: str
    """Device node (``/dev/pdcd-trigger``) or any URL of pyserial (``rfc2217://host:port``)."""
    release: Literal["rts", "dtr", "command"] = "rts"
    """What opens the shutter: a line held, or bytes sent."""
    active_low: bool = False
    """Whether the line opens the shutter when it is *not* asserted."""
    open_hex: str = ""
    close_hex: str = ""
    open_reply_hex: str = ""
    """What the box answers to each command; "" when it says nothing."""
    close_reply_hex: str = ""
    baud: Annotated[int, Meta(ge=50, le=4_000_000)] = 9600
    ready_s: _Seconds = 0.0
    """Time that a box needs after the port is opened: an Arduino restarts, which takes 2 s."""
    feedback: Literal["none", "cts", "dsr"] = "none"
    """Input that says that the shutter is open (the flash contact)."""
    feedback_active_low: bool = False
    answer_s: Annotated[float, Meta(gt=0.0, le=10.0)] = 1.0
    """How long a reply or the feedback may take; no sign of life is sent during a read."""
    limit_s: Annotated[float, Meta(gt=0.0, le=LONGEST_ANSWER_S)] | None = None
    """After how long the watchdog ends an exposure; unset: limits.max_exposure_s plus 30 s."""

    def __post_init__(self) -> None:
        commands = bytes.fromhex(self.open_hex), bytes.fromhex(self.close_hex)
        for text in (self.open_reply_hex, self.close_reply_hex):
            bytes.fromhex(text)
        if self.release == "command" and not all(commands):
            raise ValueError("release = 'command' needs open_hex and close_hex")
        if self.release == "command" and commands[0] == commands[1]:
            # A box that toggles cannot be closed from an unknown state.
            raise ValueError("open_hex and close_hex must differ")
        if self.release != "command" and any((*commands, self.open_reply_hex)):
            raise ValueError("open_hex and close_hex need release = 'command'")


def read_serial_options(config: TriggerConfig) -> SerialOptions:
    """The checked options. Raises ConfigError that says what is wrong."""
    return read_options(
        config.options,
        SerialOptions,
        table="trigger.options",
        device="shutter",
        hint="docs/cameras.md lists the options of the driver serial",
    )
