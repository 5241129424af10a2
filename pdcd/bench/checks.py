"""Faults that the types of a configuration do not exclude: wrong values, and conflicts between
keys."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from pdcd.bench.folders import MAX_SOCKET_BYTES
from pdcd.bench.grey import find_curve_fault
from pdcd.bench.placed import find_place_faults, find_small_cells
from pdcd.bench.reading import TOML_TIME_TYPES, ConfigFault, find_number_faults
from pdcd.bench.tables import (
    Config,
    DisplayConfig,
    FaultsConfig,
    RoleConfig,
    ServerConfig,
)
from pdcd.bench.truth import find_scan_fault, read_bench_truth
from pdcd.errors import ConfigError
from pdcd.panels.placing import project_points
from pdcd.panels.windows import find_window_kind

_PLANE_TIMES = (0.6, 1.4)
"""Smallest and largest time of a bit plane, relative to the mean. Where rows are counted by their
duration, one row must not look like none or two."""

RATE_TOLERANCE = 5e-4
"""Largest relative difference of the two refresh rates. At 60 Hz the panels then slip by one whole
refresh in half a minute at the fastest, which the black frames around every code still hide."""


_LONGEST_S = 60.0
"""Longest lag or response of a device; a larger number was probably meant in another unit."""
_LONGEST_WAIT_S = 3600.0
"""Longest time that a photo may take to arrive."""
_SLOWEST_S = 1.0
"""Longest response time of a panel. A slower one shows no code: dozens of refreshes pass
meanwhile."""
_RATES_HZ = 1e-3, 1e6
_APERTURES = 1e-2, 1e4
"""All refresh rates and all f-numbers lie between these; beyond, arithmetic fails."""


def check_config(config: Config) -> list[str]:
    """The messages of all faults that the types do not exclude; empty when the configuration is
    sound."""
    return [fault.message for fault in find_cross_faults(config)]


def find_cross_faults(config: Config) -> Iterator[ConfigFault]:
    """Yield the faults that involve more than the type of one key."""
    yield from find_number_faults(msgspec.to_builtins(config, builtin_types=TOML_TIME_TYPES), "")
    yield from _size_faults(config)
    yield from _panel_faults(config)
    yield from _place_faults(config)
    yield from _scene_faults(config)
    for key, refreshes in _fault_refreshes(config.display.faults):
        if not all(text.isascii() and text.isdecimal() for text in refreshes):
            yield ConfigFault((key,), f"{key}: refreshes are counted 0, 1, 2, ..., not {refreshes}")
    if config.rig.plane is not None:
        try:
            project_points(
                config.rig.plane, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
            )
        except ValueError as err:
            yield ConfigFault(("rig.plane",), f"rig.plane: {err}")
        if config.rig.arrangement != "off-axis":
            yield ConfigFault(
                ("rig.plane", "rig.arrangement"),
                'rig.plane: belongs to rig.arrangement = "off-axis"',
            )
    if config.camera.iso is not None and config.camera.iso < 1:
        yield ConfigFault(
            ("camera.iso",), f"camera.iso: must be at least 1, not {config.camera.iso}"
        )
    yield from _plane_faults(config.display)
    mask = config.mask
    if config.camera.buckets == 2 and (mask.contrast is not None or mask.rise_s or mask.fall_s):
        yield ConfigFault(
            ("camera.buckets", "mask.contrast", "mask.rise_s", "mask.fall_s"),
            "camera.buckets: a sensor of two buckets is its own mask, which switches at once and "
            "has no contrast, rise_s or fall_s",
        )
    settle_s, limit_s = config.rig.settle_s, config.limits.max_exposure_s
    if 2 * settle_s >= limit_s:
        yield ConfigFault(
            ("rig.settle_s", "limits.max_exposure_s"),
            f"rig.settle_s: settling twice for {settle_s} s leaves nothing of "
            f"limits.max_exposure_s = {limit_s} s",
        )
    socket = config.server.socket
    if socket is not None and len(os.fsencode(socket)) > MAX_SOCKET_BYTES:
        yield ConfigFault(
            ("server.socket",),
            f"server.socket: a unix socket's path has at most {MAX_SOCKET_BYTES} bytes: {socket}",
        )
    yield from _access_faults(config.server)
    yield from _truth_faults(config)


def _truth_faults(config: Config) -> Iterator[ConfigFault]:
    """Yield the faults of the file that says what the mock bench really is."""
    if config.bench.truth is None:
        return
    try:
        faults = read_bench_truth(Path(config.bench.truth), config)[1]
    except ConfigError as err:
        yield ConfigFault(("bench.truth",), f"bench.truth: {err.message}")
        return
    for fault in faults:
        yield ConfigFault(("bench.truth",), f"bench.truth: {config.bench.truth}: {fault.message}")


def _plane_faults(display: DisplayConfig) -> Iterator[ConfigFault]:
    """Yield the faults of measured times of bit planes."""
    keys = ("display.plane_starts", "display.planes_per_refresh")
    starts, count = display.plane_starts, display.planes_per_refresh
    if not starts:
        return
    if count == 1 or len(starts) != count:
        yield ConfigFault(keys, f"{keys[0]}: {len(starts)} times for {count} planes of a refresh")
        return
    low, high = (share / count for share in _PLANE_TIMES)
    if not all(low <= share <= high for share in display.plane_shares):
        yield ConfigFault(
            keys,
            f"{keys[0]}: each plane must begin after the one before, and last {low:.3g} to "
            f"{high:.3g} of a refresh",
        )


def _access_faults(server: ServerConfig) -> Iterator[ConfigFault]:
    """Yield numbers that no user or group can have."""
    if any(uid < 0 for uid in server.allow_uids):
        yield ConfigFault(("server.allow_uids",), "server.allow_uids: user ids are not negative")
    for name in ("look", "shoot", "administer"):
        role: RoleConfig = getattr(server, name)
        if any(uid < 0 for uid in role.uids):
            key = f"server.{name}.uids"
            yield ConfigFault((key,), f"{key}: user ids are not negative")
        if any(isinstance(group, int) and group < 0 for group in role.groups):
            key = f"server.{name}.groups"
            yield ConfigFault((key,), f"{key}: group ids are not negative")


def find_rate_fault(config: Config) -> ConfigFault | None:
    """The fault of two refresh rates that differ too much for lockstep; None where they do not."""
    projector_hz, mask_hz = config.projector.refresh_hz, config.mask.refresh_hz
    if abs(projector_hz - mask_hz) <= RATE_TOLERANCE * projector_hz:
        return None
    return ConfigFault(
        ("projector.refresh_hz", "mask.refresh_hz"),
        f"mask.refresh_hz: {mask_hz} differs from projector.refresh_hz = {projector_hz}; both "
        "panels need one rate to stay in lockstep",
    )


def _size_faults(config: Config) -> Iterator[ConfigFault]:
    """Yield times, rates and f-numbers that no device has."""
    longest = dict.fromkeys(("skew_s", "jitter_s", "scan_s", "lag_s"), _LONGEST_S)
    longest |= dict.fromkeys(("rise_s", "fall_s"), _SLOWEST_S)
    longest |= dict.fromkeys(("fetch_timeout_s", "readout_s"), _LONGEST_WAIT_S)
    for name in ("projector", "mask", "trigger", "camera"):
        table = getattr(config, name)
        for key, longest_s in longest.items():
            value = getattr(table, key, None) or 0.0
            if math.isfinite(value) and abs(value) > longest_s:
                yield ConfigFault(
                    (f"{name}.{key}",),
                    f"{name}.{key}: {value:g} is more than {longest_s:g} seconds, the unit of it; "
                    f"of milliseconds write {value / 1000.0:g}",
                )
    numbers = {
        "projector.refresh_hz": (config.projector.refresh_hz, _RATES_HZ),
        "mask.refresh_hz": (config.mask.refresh_hz, _RATES_HZ),
        "camera.f_number": (config.camera.f_number, _APERTURES),
    }
    for key, (number, (low, high)) in numbers.items():
        if isinstance(number, float) and math.isfinite(number) and not low <= number <= high:
            yield ConfigFault((key,), f"{key}: must be from {low:g} to {high:g}, not {number:g}")


def _panel_faults(config: Config) -> Iterator[ConfigFault]:
    """Yield what keeps the two panels from running in lockstep."""
    # Mock panels may slip: that is what they are for.
    if config.display.driver != "mock" and (fault := find_rate_fault(config)) is not None:
        yield fault
    if any(config.projector.offset_px):
        yield ConfigFault(
            ("projector.offset_px",),
            "projector.offset_px: the mask is offset against the projector: set mask.offset_px",
        )
    yield from _field_faults(config)
    if config.projector.blur_px:
        yield ConfigFault(
            ("projector.blur_px",),
            "projector.blur_px: what is blurred is the light on the mask: set mask.blur_px",
        )
    for name, panel in (("projector", config.projector), ("mask", config.mask)):
        if (fault := find_scan_fault(name, panel, config.rig.settle_s)) is not None:
            yield fault
        if abs(panel.phase_s) > 1.0 / panel.refresh_hz:
            yield ConfigFault(
                (f"{name}.phase_s", f"{name}.refresh_hz"),
                f"{name}.phase_s: {panel.phase_s} s is more than one refresh",
            )
        if (fault := find_curve_fault(name, panel.lut)) is not None:
            yield fault
        if panel.contrast is not None and panel.contrast <= 1.0:
            yield ConfigFault(
                (f"{name}.contrast",),
                f"{name}.contrast: white over black exceeds 1; leave it out for a perfect black",
            )


def _field_faults(config: Config) -> Iterator[ConfigFault]:
    """Yield the faults of the part of the projector's picture that is the field."""
    if config.mask.field_px is not None:
        yield ConfigFault(
            ("mask.field_px",),
            "mask.field_px: the field lies in the projector's picture: set projector.field_px",
        )
    if config.projector.field_px is None:
        return
    (left, top, wide, high), (width, height) = config.projector.field_px, config.projector.size_px
    if left + wide > width or top + high > height:
        yield ConfigFault(
            ("projector.field_px", "projector.size_px"),
            f"projector.field_px: {wide} x {high} pixels at ({left}, {top}) are no part of the "
            f"projector's {width} x {height}",
        )


def _place_faults(config: Config) -> Iterator[ConfigFault]:
    """Yield places on the field that no device can have."""
    tables = {name: getattr(config, name).place for name in ("projector", "mask", "camera")}
    wrong = {
        name: any(find_number_faults(msgspec.to_builtins(place), name))
        for name, place in tables.items()
    }
    for name, why in find_place_faults(config):
        if not wrong[name]:  # NaN and infinities have been reported already
            keys = (f"{name}.place", f"{name}.place.map", f"{name}.size_px", "projector.size_px")
            yield ConfigFault(keys, f"{name}.place: {why}")


def _scene_faults(config: Config) -> Iterator[ConfigFault]:
    """Yield contradictions between the scene, its cells and the panels that show them."""
    scene = config.scene
    if scene.kind == "matrix" and scene.path is None:
        yield ConfigFault(
            ("scene.kind", "scene.path"), 'scene.path: needed by scene.kind = "matrix"'
        )
    if scene.kind != "matrix" and scene.path is not None:
        yield ConfigFault(
            ("scene.kind", "scene.path"),
            f'scene.path: belongs to scene.kind = "matrix", not to "{scene.kind}"',
        )
    if scene.path is not None and not Path(scene.path).is_file():
        missing = not Path(scene.path).exists()
        what = f"there is no file {scene.path}" if missing else f"{scene.path} is no regular file"
        yield ConfigFault(("scene.path",), f"scene.path: {what}")
    if config.schedule.cells is None and scene.grid is None and scene.kind == "matrix":
        return  # the cells are known only when the file is read
    rows, cols = config.code_grid()
    window = config.schedule.window
    guard = find_window_kind(window).guard
    # Half-cell shifts of a half-cell opening fall between the pixels of a smaller cell.
    needed_px, needed = (1.0 / guard, f" by the {window} window") if guard else (1.0, "")
    for name, small_px in find_small_cells(config, (rows, cols), needed_px):
        yield ConfigFault(
            ("scene.grid", "schedule.window", f"{name}.size_px", f"{name}.place"),
            f"scene.grid: {rows} x {cols} cells leave {small_px:.3g} pixels a cell on the {name}; "
            f"{needed_px:g} are needed{needed}",
        )
    width, height = config.projector.field_size_px
    cell_px, offset_px = min(width / cols, height / rows), config.rig.misregistration_px
    if guard * cell_px < offset_px and guard:
        yield ConfigFault(
            ("scene.grid", "schedule.window", "rig.misregistration_px", "projector.size_px"),
            f"schedule.window: the {window} window covers an offset up to {guard:g} of the "
            f"cell of {cell_px:.3g} pixels, not rig.misregistration_px = {offset_px:g}",
        )


def _fault_refreshes(faults: FaultsConfig) -> Iterator[tuple[str, list[str]]]:
    """Yield each list of [display.faults] with its refresh numbers as written."""
    yield "display.faults.late", list(faults.late)
    for key in ("dropped", "stale_mask", "stale_projector"):
        yield f"display.faults.{key}", [str(number) for number in getattr(faults, key)]
