"""Grey levels of a panel, as a configuration gives them: gamma, or a table of lights."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, TypeVar

import msgspec

from pdcd.bench.reading import ConfigFault
from pdcd.bench.tables import Config, Lut, PanelConfig
from pdcd.errors import ConfigError
from pdcd.files.opening import UnsoundFileError
from pdcd.files.reading import read_file
from pdcd.panels.curve import (
    PANEL_LEVELS,
    Curve,
    Curves,
    find_table_fault,
    make_power_curve,
    make_table_curve,
)

MAX_LUT_BYTES = 2**16
"""Longest file of lights."""


class _Grey(Protocol):
    """A configuration table that has these keys."""

    @property
    def lut(self) -> Lut | None: ...


_G = TypeVar("_G", bound=_Grey)


def curve_of(panel: PanelConfig) -> Curve | None:
    """The light of a panel's grey levels; None where the configuration gives none. Raises
    ConfigError."""
    if panel.lut is None:
        return None if panel.gamma is None else make_power_curve(panel.gamma)
    lights = read_lut(Path(panel.lut)) if isinstance(panel.lut, str) else panel.lut
    if fault := find_table_fault(lights):
        raise ConfigError(f"lut {fault}")
    return make_table_curve(lights)


def curves_of(config: Config) -> Curves:
    """The curves of projector and mask. Raises ConfigError."""
    return curve_of(config.projector), curve_of(config.mask)


def find_curve_fault(name: str, lut: Lut | None) -> ConfigFault | None:
    """The fault of a table of lights that was read; None where it is sound, or there is none."""
    if lut is None or isinstance(lut, str) or not (fault := find_table_fault(lut)):
        return None
    return ConfigFault((f"{name}.lut",), f"{name}.lut: {fault}")


def with_lut(panel: _G, name: str, folder: Path, faults: list[ConfigFault]) -> _G:
    """The panel with the contents of its file of lights in place of the path, which starts from
    `folder`."""
    if not isinstance(panel.lut, str):
        return panel
    lights = None
    try:
        lights = read_lut(folder / panel.lut)
    except ConfigError as err:
        faults.append(ConfigFault((f"{name}.lut",), f"{name}.lut: {err.message}"))
    return msgspec.structs.replace(panel, lut=lights)  # type: ignore[type-var]


def read_lut(path: Path) -> tuple[float, ...]:
    """Lights of a text file: numbers separated by white space or commas, # begins a comment.

    Raises ConfigError in one line; whether the numbers make a curve is not checked.
    """
    try:
        lines = read_file(path, MAX_LUT_BYTES).decode("ascii").splitlines()
        words = [w for line in lines for w in line.partition("#")[0].replace(",", " ").split()]
        if len(words) > PANEL_LEVELS:
            raise ConfigError(f"{path} holds more than {PANEL_LEVELS} lights")
        return tuple(float(word) for word in words)
    except (UnsoundFileError, ValueError) as err:
        raise ConfigError(f"cannot read lights from {path}: {err}") from err
