"""Maps as a file, .npz, and as plain tables.

A file holds, for each device by its name, ``<device>.size_px`` (2,), ``<device>.homography``
(3, 3), and where they are not zero ``<device>.radial`` (2,), ``<device>.tangential`` (2,) and
``<device>.residual`` (rows, cols, 2).
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pdcd.errors import ConfigError
from pdcd.files.arrays import list_members, read_npz
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from pdcd.files.put import replace_file
from pdcd.files.reading import read_array_file
from pdcd.panels.map import Map, to_map_matrix
from pdcd.panels.map_soundness import MAX_NODES, check_map
from pdcd.printable import to_one_line

_NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")
"""Valid names of devices in a file."""
_MAX_MAPS = 12
"""Most maps in a file."""

_SHAPES = {"size_px": (2,), "homography": (3, 3), "radial": (2,), "tangential": (2,)}
_NUMBERS = {**{key: int(np.prod(s)) for key, s in _SHAPES.items()}, "residual": 2 * MAX_NODES**2}
_FILE = ArrayLimits(_MAX_MAPS * sum(_NUMBERS.values()))


def to_map_table(map_: Map) -> dict[str, Any]:
    """A map as a table of plain values, for TOML and JSON."""
    plain: dict[str, Any] = msgspec.to_builtins(map_)
    return plain


def from_map_table(given: Mapping[str, Any], device: str) -> Map:
    """The map that a table holds. Raises ConfigError if it is not a map, or cannot be used."""
    try:
        found = msgspec.convert(given, type=Map)
    except msgspec.ValidationError as err:
        raise ConfigError(f"this is no map: {err}", device=device) from err
    return check_map(found, device)


def save_maps(path: Path | str, maps: Mapping[str, Map]) -> None:
    """Write the maps of some devices; a file of that name is replaced once all is written.

    Raises ConfigError for a map that cannot be used or a device's name that cannot be stored,
    NoSpaceError or DiskError where the disk refuses.
    """
    if not 0 < len(maps) <= _MAX_MAPS:
        raise ConfigError(f"{len(maps)} maps for one file; it holds 1 to {_MAX_MAPS}")
    arrays: dict[str, Any] = {}
    for device, map_ in maps.items():
        if not _NAME.fullmatch(device):
            raise ConfigError(
                f"{to_one_line(repr(device))} is no name of a device in a file of maps"
            )
        for key, value in to_map_table(check_map(map_, device)).items():
            if np.any(np.array(value)):  # what is zero throughout is left out
                shape = (3, 3) if key == "homography" else np.shape(value)
                arrays[f"{device}.{key}"] = np.array(value, dtype=np.float64).reshape(shape)
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    replace_file(Path(path), packed.getvalue(), durable=True)


def load_maps(path: Path | str) -> dict[str, Map]:
    """The maps of a file by device.

    Raises ConfigError in one line for a file that is not there, is no regular file, is too large,
    damaged or not of this form, and for a map that cannot be used.
    """
    try:
        return _maps(read_array_file(path, _FILE))
    except UnsoundFileError as err:
        raise _unreadable(path, err.message) from err
    except ConfigError as err:
        raise _unreadable(path, err.message, err.device) from err


def load_map(path: Path | str, device: str) -> Map:
    """The map of one device in a file. Raises ConfigError as `load_maps`, and where it has none."""
    maps = load_maps(path)
    if device not in maps:
        raise _unreadable(path, f"it holds no map of the {device}, but of {', '.join(maps)}")
    return maps[device]


def _maps(data: bytes) -> dict[str, Map]:
    """The maps in the bytes of a file."""
    held: dict[str, dict[str, ArrayLimits]] = {}
    for name in list_members(data):
        device, _, key = name.rpartition(".")
        if not _NAME.fullmatch(device) or key not in _NUMBERS:
            raise UnsoundFileError(f"{name!r} is not of a map")
        held.setdefault(device, {})[key] = ArrayLimits(_NUMBERS[key])
    if len(held) > _MAX_MAPS:
        raise UnsoundFileError(f"it holds {len(held)} maps; at most {_MAX_MAPS} are read")
    return {device: _map(data, device, keys) for device, keys in held.items()}


def _map(data: bytes, device: str, keys: Mapping[str, ArrayLimits]) -> Map:
    """One map of a file."""
    missing = [key for key in ("size_px", "homography") if key not in keys]
    if missing:
        raise UnsoundFileError(f"the {device} has no {' and no '.join(missing)}")
    found = read_npz(data, {f"{device}.{key}": limits for key, limits in keys.items()})
    arrays = {name.rpartition(".")[2]: array for name, array in found.items()}
    for key, array in arrays.items():
        wanted = _SHAPES.get(key, (*array.shape[:2], 2))
        if array.shape != wanted:
            raise UnsoundFileError(f"`{device}.{key}` has the shape {array.shape}, not {wanted}")
    width, height = arrays["size_px"].tolist()
    if not (width.is_integer() and height.is_integer()):
        raise UnsoundFileError(f"`{device}.size_px` is {width} x {height}: not whole pixels")
    plain: dict[str, Any] = {key: array.tolist() for key, array in arrays.items()}
    plain |= {
        "size_px": (int(width), int(height)), "homography": to_map_matrix(arrays["homography"]),
    }  # fmt: skip
    return from_map_table(plain, device)


def _unreadable(path: Path | str, why: str, device: str | None = None) -> ConfigError:
    return ConfigError(
        to_one_line(f"the maps of {path} cannot be used: {why}"),
        device=device,
        hint="give a file that a calibration or pdcd.panels.map_file.save_maps wrote",
    )
