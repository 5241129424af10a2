"""Configuration: one TOML file -> typed, checked values. Units are in the names.

`Config()` with nothing given is the mock bench. One file is read and never merged with another; a
key left out takes the value of the mock bench, an unknown one is refused, and every fault of the
file is reported at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from pdcd.bench.checks import find_cross_faults
from pdcd.bench.folders import read_folder_variable
from pdcd.bench.grey import with_lut
from pdcd.bench.reading import (
    NO_NOTES,
    TOML_TIME_TYPES,
    ConfigFault,
    format_toml,
    make_faults_error,
    merge_table,
    read_toml,
)
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.map_file import load_map

_DEVICES = ("projector", "mask", "camera")
"""Tables with a place on the field."""


def load_config(path: Path | str | None = None) -> Config:
    """Read the configuration file that `find_config_file` names; the mock bench where there is
    none.

    Relative paths in the file start from its folder; for the scene, the sensor profile and the
    truth of the mock bench the current folder is tried next.

    Raises ConfigError naming all faults of the file, one a line.
    """
    source = find_config_file(path)
    if source is None:
        return Config()
    config, faults = read_config(source)
    if faults:
        raise make_faults_error(source, [fault.message for fault in faults])
    return config


def read_config(source: Path) -> tuple[Config, list[ConfigFault]]:
    """Read one file: its configuration, and all its faults.

    A key with a fault has its default value. Raises ConfigError for what is no TOML file.
    """
    hint = "give an existing file with --config, or none for the mock bench"
    table = read_toml(source, "the configuration", hint, may_be_pipe=True)
    return _of_table(table, source.absolute().parent)


def from_config_tables(table: dict[str, Any], called: str, base: Config | None = None) -> Config:
    """A configuration from the tables of a file that was never written, as `load_config` reads a
    file.

    Relative paths start from the current folder; `called` names the tables for people. A key that
    is left out takes the value of `base`; None: of the mock bench. Raises ConfigError naming all
    faults.
    """
    config, faults = _of_table(table, Path.cwd(), base)
    if faults:
        raise make_faults_error(called, [fault.message for fault in faults])
    return config


def _of_table(
    table: dict[str, Any], folder: Path, base: Config | None = None
) -> tuple[Config, list[ConfigFault]]:
    """The configuration in the tables of a file in `folder`, and all their faults."""
    faults: list[ConfigFault] = []
    config = merge_table(base or Config(), table, "", faults)
    config = _resolve(config, folder)
    config = _with_maps(config, faults)
    config = _with_luts(config, folder, faults)
    known = {key for fault in faults for key in fault.keys}
    # A key that could not be read has its default value; faults that follow from that are not
    # repeated.
    faults += [fault for fault in find_cross_faults(config) if known.isdisjoint(fault.keys)]
    return config, faults


def find_config_file(path: Path | str | None = None) -> Path | None:
    """Return the file to read: `path` if given, else the first that exists, else None.

    Looked for are `pdcd.toml` in $CONFIGURATION_DIRECTORY (set by systemd), then in
    $XDG_CONFIG_HOME/pdcd, or in ~/.config/pdcd without that variable.
    """
    if path is not None:
        return Path(path)
    candidates = []
    if folder := read_folder_variable("CONFIGURATION_DIRECTORY"):
        candidates.append(folder / "pdcd.toml")
    if folder := read_folder_variable("XDG_CONFIG_HOME"):
        candidates.append(folder / "pdcd" / "pdcd.toml")
    elif folder := read_folder_variable("HOME"):
        candidates.append(folder / ".config" / "pdcd" / "pdcd.toml")
    for candidate in candidates:
        try:
            if candidate.is_file():
                return candidate
        except PermissionError:  # a home folder hidden by ProtectHome= holds nothing for us
            continue
    return None


def format_config(config: Config, notes: Mapping[tuple[str, ...], str] = NO_NOTES) -> str:
    """Return the configuration as TOML that `load_config` reads back to the same value, with
    comments."""
    return format_toml(msgspec.to_builtins(config, builtin_types=TOML_TIME_TYPES), notes)


def make_config_schema() -> dict[str, Any]:
    """JSON Schema of the file."""
    return msgspec.json.schema(Config)


def _resolve(config: Config, folder: Path) -> Config:
    """Make the paths of a file in `folder` absolute."""
    scene, camera, server, bench = config.scene, config.camera, config.server, config.bench
    if scene.path is not None:
        scene = msgspec.structs.replace(scene, path=_input_path(scene.path, folder))
    if "/" in camera.profile or camera.profile.endswith(".toml"):
        camera = msgspec.structs.replace(camera, profile=_input_path(camera.profile, folder))
    if bench.truth is not None:
        bench = msgspec.structs.replace(bench, truth=_input_path(bench.truth, folder))
    places = {
        key: str(folder / _expand(value))
        for key in ("socket", "state_dir", "arrays")
        if (value := getattr(server, key)) is not None
    }
    server = msgspec.structs.replace(server, **places)
    resolved = msgspec.structs.replace(
        config, scene=scene, camera=camera, server=server, bench=bench
    )
    for device in _DEVICES:
        given = getattr(resolved, device).place.map
        if isinstance(given, str):
            resolved = _placed_by(resolved, device, str(folder / _expand(given)))
    return resolved


def _with_maps(config: Config, faults: list[ConfigFault]) -> Config:
    """The configuration with the contents of its map files in place of their names."""
    for device in _DEVICES:
        given = getattr(config, device).place.map
        if not isinstance(given, str):
            continue
        try:
            config = _placed_by(config, device, load_map(given, device))
        except ConfigError as err:
            key = f"{device}.place.map"
            faults.append(ConfigFault((key,), f"{key}: {err.message}"))
            config = _placed_by(config, device, None)
    return config


def _with_luts(config: Config, folder: Path, faults: list[ConfigFault]) -> Config:
    """The configuration with the contents of its files of lights in place of their names."""
    return msgspec.structs.replace(
        config,
        projector=with_lut(config.projector, "projector", folder, faults),
        mask=with_lut(config.mask, "mask", folder, faults),
    )


def _placed_by(config: Config, device: str, map_: str | Map | None) -> Config:
    """The configuration with another map of a device."""
    table = getattr(config, device)
    place = msgspec.structs.replace(table.place, map=map_)
    return msgspec.structs.replace(config, **{device: msgspec.structs.replace(table, place=place)})


def _input_path(text: str, folder: Path) -> str:
    """Absolute path of an input file: from `folder`, else from the current folder."""
    path = _expand(text)
    beside = folder / path
    return str(path.absolute() if path.exists() and not beside.exists() else beside)


def _expand(text: str) -> Path:
    """Replace a leading ~ by the home folder, where there is one."""
    try:
        return Path(text).expanduser()
    except RuntimeError:
        return Path(text)
