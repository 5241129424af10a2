"""Configuration: one TOML file -> typed, checked values. Units are in the names.

`Config()` with nothing given is the mock bench. One file is read and never merged with another; a
key left out takes the value of the mock bench, an unknown one is refused, and every fault of the
file is reported at once.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pdcd.bench.checks import Fault, cross_faults
from pdcd.bench.folders import folder_variable
from pdcd.bench.options import convert_field, unknown_key
from pdcd.bench.tables import Config
from pdcd.bench.toml_text import TIMES, emit
from pdcd.errors import ConfigError

_S = TypeVar("_S", bound=msgspec.Struct)

GONE = {
    "camera.homography": "is no more; pictures stay as the sensor has them, and [camera.place] "
    "says where they lie on the field",
}
"""Keys of earlier versions, and what takes their place."""


def load(path: Path | str | None = None) -> Config:
    """Read the configuration file that `find` names, or the mock bench when there is none.

    Relative paths in the file are meant from its folder; for the scene and the sensor profile the
    current folder is tried next.

    Raises ConfigError naming all faults of the file, one a line.
    """
    source = find(path)
    if source is None:
        return Config()
    config, faults = read(source)
    if faults:
        raise faults_error(source, [fault.message for fault in faults])
    return config


def faults_error(source: Path | None, lines: Sequence[str]) -> ConfigError:
    """The error that lists all faults of a file, one a line; None is the mock bench."""
    count = f"{len(lines)} faults" if len(lines) > 1 else "1 fault"
    listed = "\n  ".join(lines)
    return ConfigError(f"{count} in {source or 'the mock bench'}:\n  {listed}")


def read(source: Path) -> tuple[Config, list[Fault]]:
    """Read one file: its configuration, and all its faults.

    A key that is at fault stands at its default. Raises ConfigError for what is no TOML file.
    """
    try:
        table = tomllib.loads(source.read_text(encoding="utf-8"))
        beyond = list(_beyond_64_bits(table))
    except OSError as err:
        raise ConfigError(
            f"cannot read the configuration {source}: {err.strerror}",
            hint="give an existing file with --config, or none for the mock bench",
        ) from err
    except RecursionError as err:
        raise ConfigError(f"{source} is nested too deeply") from err
    except ValueError as err:  # not TOML, not UTF-8, or a number of thousands of digits
        raise ConfigError(f"{source} is not TOML: {err}") from err

    if beyond:
        raise _told(source, [f"{key}: a number has more than 64 bits" for key in beyond])
    faults: list[Fault] = []
    config = _overlay(Config(), table, "", faults)
    config = _resolve(config, source.absolute().parent)
    known = {key for fault in faults for key in fault.keys}
    # A key that could not be read stands at its default; what follows from that is no news.
    faults += [fault for fault in cross_faults(config) if known.isdisjoint(fault.keys)]
    return config, faults


def _told(source: Path, faults: list[str]) -> ConfigError:
    count = f"{len(faults)} faults" if len(faults) > 1 else "1 fault"
    lines = "\n  ".join(faults)
    return ConfigError(f"{count} in {source}:\n  {lines}")


def find(path: Path | str | None = None) -> Path | None:
    """Return the file to read: `path` if given, else the first that exists, else None.

    Looked for are `pdcd.toml` in $CONFIGURATION_DIRECTORY (set by systemd), then in
    $XDG_CONFIG_HOME/pdcd, or in ~/.config/pdcd without that variable.
    """
    if path is not None:
        return Path(path)
    candidates = []
    if folder := folder_variable("CONFIGURATION_DIRECTORY"):
        candidates.append(folder / "pdcd.toml")
    if folder := folder_variable("XDG_CONFIG_HOME"):
        candidates.append(folder / "pdcd" / "pdcd.toml")
    elif folder := folder_variable("HOME"):
        candidates.append(folder / ".config" / "pdcd" / "pdcd.toml")
    for candidate in candidates:
        try:
            if candidate.is_file():
                return candidate
        except PermissionError:  # a home folder hidden by ProtectHome= holds nothing for us
            continue
    return None


def show(config: Config) -> str:
    """Return the configuration as TOML that `load` reads back to the same value."""
    return emit(msgspec.to_builtins(config, builtin_types=TIMES))


def schema() -> dict[str, Any]:
    """JSON Schema of the file."""
    return msgspec.json.schema(Config)


def _beyond_64_bits(value: Any, key: str = "") -> Iterator[str]:
    """Keys of integers that TOML does not know, and that floats cannot always hold."""
    if isinstance(value, dict):
        for name, held in value.items():
            yield from _beyond_64_bits(held, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for held in value:
            yield from _beyond_64_bits(held, key)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        yield key


def _overlay(base: _S, given: Any, where: str, faults: list[Fault]) -> _S:
    """Copy of `base` with the keys of the table `given` put in, each checked against its type.

    Keys that cannot be read are left as they are in `base` and reported in `faults`.
    """
    if not isinstance(given, dict):
        faults.append(Fault((where,), f"{where}: must be a table, not {given!r}"))
        return base
    fields = {f.encode_name: f for f in msgspec.structs.fields(base)}
    values: dict[str, Any] = {}
    for key, value in given.items():
        name = f"{where}.{key}" if where else key
        if key not in fields:
            gone = GONE.get(name)
            told = f"{name}: {gone}" if gone else unknown_key(name, key, fields)
            faults.append(Fault((name,), told))
            continue
        present = getattr(base, fields[key].name)
        if isinstance(present, msgspec.Struct):
            values[key] = _overlay(present, value, name, faults)
            continue
        try:
            values[key] = convert_field(value, fields[key], name)
        except ValueError as err:
            faults.append(Fault((name,), str(err)))
    return msgspec.structs.replace(base, **values)


def _resolve(config: Config, folder: Path) -> Config:
    """Make the paths of a file in `folder` absolute."""
    scene, camera, server = config.scene, config.camera, config.server
    if scene.path is not None:
        scene = msgspec.structs.replace(scene, path=_input_path(scene.path, folder))
    if "/" in camera.profile or camera.profile.endswith(".toml"):
        camera = msgspec.structs.replace(camera, profile=_input_path(camera.profile, folder))
    places = {
        key: str(folder / _expand(value))
        for key in ("socket", "state_dir", "arrays")
        if (value := getattr(server, key)) is not None
    }
    server = msgspec.structs.replace(server, **places)
    return msgspec.structs.replace(config, scene=scene, camera=camera, server=server)


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
