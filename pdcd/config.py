"""Configuration: one TOML file -> typed, checked values. Units are in the names.

`Config()` with nothing given is the mock bench. One file is read and never merged with another; a
key left out takes the value of the mock bench, an unknown one is refused, and every fault of the
file is reported at once.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec

from pdcd.errors import ConfigError
from pdcd.settings import (
    CameraConfig,
    Config,
    DisplayConfig,
    FaultsConfig,
    Homography,
    LimitsConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
    ScheduleConfig,
    ServerConfig,
    TriggerConfig,
)
from pdcd.toml_text import TIMES, emit

__all__ = [
    "CameraConfig",
    "Config",
    "DisplayConfig",
    "FaultsConfig",
    "Homography",
    "LimitsConfig",
    "PanelConfig",
    "RigConfig",
    "SceneConfig",
    "ScheduleConfig",
    "ServerConfig",
    "TriggerConfig",
    "check",
    "find",
    "load",
    "schema",
    "show",
    "socket_path",
    "state_dir",
]

RATE_TOLERANCE = 5e-4
"""Largest relative difference of the two refresh rates: at 60 Hz they then slip by one whole
refresh in half a minute at the fastest, which the black frames around every code still hide."""
MAX_INTEGER = 2**53
"""Integers stay below this in every message, so that any JSON reader keeps them exactly."""
MAX_SOCKET_BYTES = 107
"""Longest path of a unix socket: `sun_path` of unix(7) less its closing NUL."""
DEFAULT_GRID = (48, 64)
"""Rows and columns of cells when neither the file nor a matrix says otherwise."""


_S = TypeVar("_S", bound=msgspec.Struct)


class _Fault(NamedTuple):
    """One fault: the keys it is about (dotted) and what to do."""

    keys: tuple[str, ...]
    message: str


def load(path: Path | str | None = None) -> Config:
    """Read the configuration file that `find` names, or the mock bench when there is none.

    Relative paths in the file are meant from its folder; for the scene and the sensor profile the
    current folder is tried next.

    Raises ConfigError naming all faults of the file, one a line.
    """
    source = find(path)
    if source is None:
        return Config()
    try:
        table = tomllib.loads(source.read_text(encoding="utf-8"))
    except OSError as err:
        raise ConfigError(
            f"cannot read the configuration {source}: {err.strerror}",
            hint="give an existing file with --config, or none for the mock bench",
        ) from err
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as err:
        raise ConfigError(f"{source} is not TOML: {err}") from err

    faults: list[_Fault] = []
    config = _overlay(Config(), table, "", faults)
    config = _resolve(config, source.absolute().parent)
    known = {key for fault in faults for key in fault.keys}
    # A key that could not be read stands at its default; what follows from that is no news.
    faults += [fault for fault in _cross_faults(config) if known.isdisjoint(fault.keys)]
    if faults:
        count = f"{len(faults)} faults" if len(faults) > 1 else "1 fault"
        lines = "\n  ".join(fault.message for fault in faults)
        raise ConfigError(f"{count} in {source}:\n  {lines}")
    return config


def find(path: Path | str | None = None) -> Path | None:
    """Return the file to read: `path` if given, else the first that exists, else None.

    Looked for are `pdcd.toml` in $CONFIGURATION_DIRECTORY (set by systemd), then in
    $XDG_CONFIG_HOME/pdcd, or in ~/.config/pdcd without that variable.
    """
    if path is not None:
        return Path(path)
    candidates = []
    if folder := _folder_variable("CONFIGURATION_DIRECTORY"):
        candidates.append(folder / "pdcd.toml")
    if folder := _folder_variable("XDG_CONFIG_HOME"):
        candidates.append(folder / "pdcd" / "pdcd.toml")
    elif folder := _folder_variable("HOME"):
        candidates.append(folder / ".config" / "pdcd" / "pdcd.toml")
    for candidate in candidates:
        try:
            if candidate.is_file():
                return candidate
        except PermissionError:  # a home folder hidden by ProtectHome= holds nothing for us
            continue
    return None


def check(config: Config) -> list[str]:
    """Every fault that the types alone do not exclude; empty when the configuration is sound."""
    return [fault.message for fault in _cross_faults(config)]


def show(config: Config) -> str:
    """Return the configuration as TOML that `load` reads back to the same value."""
    return emit(msgspec.to_builtins(config, builtin_types=TIMES))


def schema() -> dict[str, Any]:
    """JSON Schema of the file."""
    return msgspec.json.schema(Config)


def socket_path(config: Config) -> Path:
    """Where the daemon listens and clients call.

    Raises ConfigError when the stand-in for a missing $XDG_RUNTIME_DIR belongs to someone else.
    """
    if config.server.socket is not None:
        return Path(config.server.socket)
    if folder := _folder_variable("RUNTIME_DIRECTORY"):
        # Beside the folder, not in it: systemd deletes the folder when the service stops.
        return folder.parent / "pdcd.sock"
    return (_folder_variable("XDG_RUNTIME_DIR") or _private_folder()) / "pdcd.sock"


def state_dir(config: Config) -> Path:
    """Folder that run folders and calibrations are kept in; it need not exist yet."""
    if config.server.state_dir is not None:
        return Path(config.server.state_dir)
    if folder := _folder_variable("STATE_DIRECTORY"):
        return folder
    if home := _folder_variable("XDG_STATE_HOME"):
        return home / "pdcd"
    return Path.home() / ".local" / "state" / "pdcd"


def _folder_variable(name: str) -> Path | None:
    """First absolute folder of a variable; systemd separates several by colons."""
    first = os.environ.get(name, "").split(":")[0]
    # The XDG base directory specification tells programs to ignore relative values.
    return Path(first) if first.startswith("/") else None


def _private_folder() -> Path:
    """Folder of this user alone below the system's temporary folder, made when missing."""
    folder = Path(tempfile.gettempdir()) / f"pdcd-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
    except OSError as err:
        raise ConfigError(
            f"cannot make the folder {folder}: {err.strerror}",
            hint="set [server].socket",
        ) from err
    found = folder.lstat()
    # Anybody may create names in the temporary folder, a symbolic link included.
    if folder.is_symlink() or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise ConfigError(
            f"{folder} is not a private folder of this user",
            hint="remove it, or set [server].socket",
        )
    return folder


def _overlay(base: _S, given: Any, where: str, faults: list[_Fault]) -> _S:
    """Copy of `base` with the keys of the table `given` put in, each checked against its type.

    Keys that cannot be read are left as they are in `base` and reported in `faults`.
    """
    if not isinstance(given, dict):
        faults.append(_Fault((where,), f"{where}: must be a table, not {given!r}"))
        return base
    fields = {f.encode_name: f for f in msgspec.structs.fields(base)}
    values: dict[str, Any] = {}
    for key, value in given.items():
        name = f"{where}.{key}" if where else key
        if key not in fields:
            close = difflib.get_close_matches(key, fields, n=1)
            advice = f"; is {close[0]} meant?" if close else f"; known are {', '.join(fields)}"
            faults.append(_Fault((name,), f"{name}: no such key{advice}"))
            continue
        present = getattr(base, fields[key].name)
        if isinstance(present, msgspec.Struct):
            values[key] = _overlay(present, value, name, faults)
            continue
        try:
            values[key] = msgspec.convert(value, type=fields[key].type, strict=True)
        except msgspec.ValidationError as err:
            faults.append(_Fault((name,), _type_fault(name, str(err), fields[key].type)))
    return msgspec.structs.replace(base, **values)


def _type_fault(name: str, message: str, kind: Any) -> str:
    """Say a conversion error in the words of the file: the key first, no type notation marks."""
    what, _, place = message.partition(" - at `$")
    if what.startswith("Invalid enum value"):
        values = re.findall(r"'([^']*)'", str(kind))
        number = ["a number"] if "float" in str(kind) else []
        what = f"{what}; allowed are {', '.join(values + number)}"
    what = what[0].lower() + what[1:].replace("`", "")
    return f"{name}{place.rstrip('`').replace('[...]', '')}: {what}"


def _resolve(config: Config, folder: Path) -> Config:
    """Make the paths of a file in `folder` absolute."""
    scene, camera, server = config.scene, config.camera, config.server
    if scene.path is not None:
        scene = msgspec.structs.replace(scene, path=_input_path(scene.path, folder))
    if "/" in camera.profile or camera.profile.endswith(".toml"):
        camera = msgspec.structs.replace(camera, profile=_input_path(camera.profile, folder))
    places = {
        key: str(folder / _expand(value))
        for key in ("socket", "state_dir")
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


def _cross_faults(config: Config) -> Iterator[_Fault]:
    """Yield the faults that involve more than the type of one key."""
    yield from _number_faults(msgspec.to_builtins(config, builtin_types=TIMES), "")
    yield from _panel_faults(config)
    yield from _scene_faults(config)
    for key, refreshes in _fault_refreshes(config.display.faults):
        if not all(text.isascii() and text.isdecimal() for text in refreshes):
            yield _Fault((key,), f"{key}: refreshes are counted 0, 1, 2, ..., not {refreshes}")
    if config.camera.iso is not None and config.camera.iso < 1:
        yield _Fault(("camera.iso",), f"camera.iso: must be at least 1, not {config.camera.iso}")
    settle_s, limit_s = config.rig.settle_s, config.limits.max_exposure_s
    if 2 * settle_s >= limit_s:
        yield _Fault(
            ("rig.settle_s", "limits.max_exposure_s"),
            f"rig.settle_s: settling twice for {settle_s} s leaves nothing of "
            f"limits.max_exposure_s = {limit_s} s",
        )
    socket = config.server.socket
    if socket is not None and len(os.fsencode(socket)) > MAX_SOCKET_BYTES:
        yield _Fault(
            ("server.socket",),
            f"server.socket: a unix socket's path has at most {MAX_SOCKET_BYTES} bytes: {socket}",
        )
    if any(uid < 0 for uid in config.server.allow_uids):
        yield _Fault(("server.allow_uids",), "server.allow_uids: user ids are not negative")


def _number_faults(value: Any, key: str) -> Iterator[_Fault]:
    """Yield NaN, infinities and integers too large for JSON, however deep they lie."""
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _number_faults(item, f"{key}.{name}" if key else name)
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _number_faults(item, f"{key}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield _Fault((key,), f"{key}: must be a finite number, not {value}")
    elif isinstance(value, int) and abs(value) >= MAX_INTEGER:
        yield _Fault((key,), f"{key}: must be below 2**53 in size, not {value}")


def _panel_faults(config: Config) -> Iterator[_Fault]:
    """Yield what keeps the two panels from running in lockstep."""
    rates = {"projector": config.projector.refresh_hz, "mask": config.mask.refresh_hz}
    # Mock panels may slip: that is what they are for.
    if config.display.driver != "mock" and (
        abs(rates["projector"] - rates["mask"]) > RATE_TOLERANCE * rates["projector"]
    ):
        yield _Fault(
            ("projector.refresh_hz", "mask.refresh_hz"),
            f"mask.refresh_hz: {rates['mask']} differs from projector.refresh_hz = "
            f"{rates['projector']}; both panels need one rate to stay in lockstep",
        )
    if any(config.projector.offset_px):
        yield _Fault(
            ("projector.offset_px",),
            "projector.offset_px: the mask is offset against the projector: set mask.offset_px",
        )
    for name, panel in (("projector", config.projector), ("mask", config.mask)):
        if abs(panel.phase_s) > 1.0 / panel.refresh_hz:
            yield _Fault(
                (f"{name}.phase_s", f"{name}.refresh_hz"),
                f"{name}.phase_s: {panel.phase_s} s is more than one refresh",
            )
        if panel.contrast is not None and panel.contrast <= 1.0:
            yield _Fault(
                (f"{name}.contrast",),
                f"{name}.contrast: white over black exceeds 1; leave it out for a perfect black",
            )


def _scene_faults(config: Config) -> Iterator[_Fault]:
    """Yield contradictions between the scene, its cells and the panels that show them."""
    scene = config.scene
    if scene.kind == "matrix" and scene.path is None:
        yield _Fault(("scene.kind", "scene.path"), 'scene.path: needed by scene.kind = "matrix"')
    if scene.kind != "matrix" and scene.path is not None:
        yield _Fault(
            ("scene.kind", "scene.path"),
            f'scene.path: belongs to scene.kind = "matrix", not to "{scene.kind}"',
        )
    if scene.path is not None and not Path(scene.path).is_file():
        yield _Fault(("scene.path",), f"scene.path: there is no file {scene.path}")
    if scene.grid is None and scene.kind == "matrix":
        return  # the cells are known only when the file is read
    rows, cols = scene.grid or DEFAULT_GRID
    quarter = config.schedule.window == "quarter"
    for name, panel in (("projector", config.projector), ("mask", config.mask)):
        cell_px = min(panel.size_px[0] / cols, panel.size_px[1] / rows)
        # Half-cell shifts of a half-cell opening fall between the pixels of a smaller cell.
        needed_px = 4.0 if quarter else 1.0
        if cell_px < needed_px:
            yield _Fault(
                ("scene.grid", "schedule.window", f"{name}.size_px"),
                f"scene.grid: {rows} x {cols} cells leave {cell_px:.3g} pixels a cell on the "
                f"{name}; {needed_px:g} are needed{' by the quarter window' if quarter else ''}",
            )
        offset_px = config.rig.misregistration_px
        if name == "projector" and quarter and cell_px < 4.0 * offset_px:
            yield _Fault(
                ("scene.grid", "schedule.window", "rig.misregistration_px", "projector.size_px"),
                f"schedule.window: the quarter window covers an offset up to a quarter of the "
                f"cell of {cell_px:.3g} pixels, not rig.misregistration_px = {offset_px:g}",
            )


def _fault_refreshes(faults: FaultsConfig) -> Iterator[tuple[str, list[str]]]:
    """Yield each list of [display.faults] with its refresh numbers as written."""
    yield "display.faults.late", list(faults.late)
    for key in ("dropped", "stale_mask", "stale_projector"):
        yield f"display.faults.{key}", [str(number) for number in getattr(faults, key)]
