"""From a configuration to the request that opens its panels."""

from __future__ import annotations

from pdcd.bench.options import read_options
from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from pdcd.presenter.messages import Mode, Open
from pdcd.presenter.options import Options


def options_of(config: Config) -> Options:
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
        Options,
        table="display.options",
        device="display",
        hint="docs/display.md lists the options of the driver x11",
    )


def opening(config: Config) -> Open:
    """What the display process is asked to open. Raises ConfigError."""
    options = options_of(config)
    if config.rig.clock != "real":
        raise ConfigError(
            "real panels keep real time", device="display", hint='set rig.clock = "real"'
        )
    panels, display = panels_of(config), config.display
    return Open(
        options,
        Mode(panels.projector.map, config.projector.refresh_hz),
        Mode(panels.mask.map, config.mask.refresh_hz),
        display.plane_order if display.planes_per_refresh > 1 else None,
    )
