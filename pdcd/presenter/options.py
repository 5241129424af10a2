"""The settings of [display.options] for the x11 driver."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta, field

from pdcd.bench.reading import read_options
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError

SourceName = Literal["auto", "present-complete", "present-msc", "swap", "clock", "free"]
VERIFIED: tuple[SourceName, ...] = ("present-complete",)
"""Sources that prove presentation, frame by frame, where every frame was a page flip."""
_LayoutName = Literal["span", "windows"]

_RefreshNumber = Annotated[str, Meta(pattern=r"^[0-9]+$")]


class X11Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[display.options]: which outputs, in which windows, on which clock."""

    projector: str
    """RandR connector ("HDMI-1") or EDID serial of the projector."""
    mask: str
    """The same for the mask."""
    display: str | None = None
    """X display (":7"); unset: $DISPLAY."""
    layout: _LayoutName = "span"
    """One window over the whole X screen, or one window for each output."""
    time_source: SourceName = "auto"
    """Where presentation times come from; "auto" takes the best source that delivers, "free" keeps
    no pace and is for benchmarks only."""
    allow_software: bool = False
    """Accept a renderer without a graphics card: for tests."""
    realtime_priority: Annotated[int, Meta(ge=0, le=99)] = 20
    """SCHED_FIFO priority of the loop; 0 leaves the ordinary scheduler."""
    hang_s: Annotated[float, Meta(ge=0.1, le=60.0)] = 2.0
    """A loop that shows nothing for this long is killed, and the panels go black."""
    positions_px: tuple[tuple[int, int], tuple[int, int]] | None = None
    """Places of projector and mask on an X screen whose server has one output (Xvfb)."""
    grab_px: tuple[tuple[int, int], tuple[int, int]] | None = None
    """Where on the X screen a virtual bench has its projector and its mask (x, y). Their pixels are
    read after every refresh, and a mock camera's photo is made of these pixels. It is for tests, on
    servers without a graphics card, at small sizes."""
    stalls_ms: dict[_RefreshNumber, Annotated[float, Meta(ge=0.0)]] = field(default_factory=dict)
    """Fault injection, for tests: refresh of an exposure -> how long the loop sleeps after it."""
    stall_exposures: Annotated[int, Meta(ge=0)] = 0
    """Fault injection: number of exposures with these stalls, from the first on; 0 is all."""

    def __post_init__(self) -> None:
        """Refuse one output for both panels, unless `positions_px` divides it."""
        if self.projector == self.mask and self.positions_px is None:
            raise ValueError(
                f'mask: "{self.mask}" is the projector\'s output, too; name the one of the mask'
            )


def read_x11_options(config: Config) -> X11Options:
    """[display.options] of the driver x11. Raises ConfigError."""
    if config.display.driver != "x11":
        raise ConfigError(
            "panels are looked at with the driver x11; the configuration has "
            f"{config.display.driver!r}",
            device="display",
            hint='name two outputs in a configuration with [display] driver = "x11", and give it '
            "with --config; docs/display.md shows how",
        )
    return read_options(
        config.display.options,
        X11Options,
        table="display.options",
        device="display",
        hint="docs/display.md lists the options of the driver x11",
    )
