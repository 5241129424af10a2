"""[display.options] of the driver `dlpc900`."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from pdcd.driver import Config, ConfigError, read_options

from .erle import CopyAbove, PlaneOrder

_HINT = "docs/dlpc900.md lists the options of the driver dlpc900"
_Name = Annotated[str, Meta(min_length=1)]


class DmdOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of a display of two DMDs, however pictures get to them."""

    projector: _Name
    mask: _Name
    """Serial number of each, or the port it is plugged into ("1-4.2"); `pdcd doctor display` lists
    both."""
    usb: _Name = "libusb"
    """The machine's own libusb, or the name of a driver of the role `usb`."""
    trigger_bit: Literal[0, 1] = 1
    """Bit 0 of byte 9 of each entry with light, for a pulse at TRIG_OUT_2; TI's guide and programs
    disagree on its value. Black entries of `dlpc900` have the other value."""
    led: Annotated[int, Meta(ge=0, le=7)] = 1
    """LEDs that are lit with each plane, as bits."""
    rest: Literal["black", "standby", "idle"] = "black"
    """What mirrors do after the display is closed: hold black, park, or toggle evenly to last
    longer. Only black is dark."""


class Dlpc900Options(DmdOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which two devices, how they start, and choices that the guides leave open."""

    start: Literal["trigger", "chain", "software"] = "trigger"
    """What starts a sequence. "trigger": an edge from the camera on TRIG_IN_1 of both. "chain": the
    computer starts the projector, whose TRIG_OUT_1 starts the mask through its TRIG_IN_1.
    "software": the computer starts each by itself."""
    edge: Literal["rising", "falling"] = "rising"
    """Which edge on TRIG_IN_1."""
    plane_order: PlaneOrder = "GBR"
    """Which byte of a pixel holds planes 0-7, 8-15 and 16-23, where R is sent first: "GBR" as in
    TI's programs, "BGR" as in others."""
    copy_above: CopyAbove = "lines"
    """What compressed pictures may copy from the line above: whole lines, "parts" of a line (which
    is much shorter for turned panels), or nothing."""

    @property
    def in_process(self) -> bool:
        """Whether the devices are virtual ones."""
        return self.usb != "libusb"


def read_dlpc900_options(config: Config) -> Dlpc900Options:
    """The options of this rig's display. Raises ConfigError if they are wrong."""
    options = read_options(
        config.display.options,
        Dlpc900Options,
        table="display.options",
        device="display",
        hint=_HINT,
    )
    if options.projector == options.mask:
        raise ConfigError(
            f"projector and mask are both {options.mask!r}",
            device="display",
            hint="name two devices; pdcd doctor display lists them",
        )
    if config.display.planes_per_refresh > 1:
        raise ConfigError(
            "display.planes_per_refresh is of DLPs on a video signal",
            device="display",
            hint="leave it out: the driver dlpc900 shows one row a plane",
        )
    return options
