"""What the types of a configuration alone do not exclude: faults of values, and between keys."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from pdcd.bench.folders import MAX_SOCKET_BYTES
from pdcd.bench.grey import curve_fault
from pdcd.bench.placed import place_faults, small_cells
from pdcd.bench.reading import TIMES, Fault, number_faults
from pdcd.bench.tables import (
    Config,
    DisplayConfig,
    FaultsConfig,
    RoleConfig,
    ServerConfig,
)
from pdcd.bench.truth import read_truth, scan_fault
from pdcd.errors import ConfigError
from pdcd.panels.placing import through
from pdcd.panels.windows import windows

PLANE_TIMES = (0.6, 1.4)
"""Times of bit planes over their mean: where rows are counted by the time they last, one must not
pass for none or two."""

RATE_TOLERANCE = 5e-4
"""Largest relative difference of the two refresh rates: at 60 Hz they then slip by one whole
refresh in half a minute at the fastest, which the black frames around every code still hide."""


LONGEST_S = 60.0
"""Longest lag or response of a device: what is more was meant in another unit."""
RATES_HZ = 1e-3, 1e6
APERTURES = 1e-2, 1e4
"""Between these lie all refresh rates and all f-numbers; beyond, arithmetic fails."""


def check(config: Config) -> list[str]:
    """Every fault that the types alone do not exclude; empty when the configuration is sound."""
    return [fault.message for fault in cross_faults(config)]


def cross_faults(config: Config) -> Iterator[Fault]:
    """Yield the faults that involve more than the type of one key."""
    yield from number_faults(msgspec.to_builtins(config, builtin_types=TIMES), "")
    yield from _size_faults(config)
    yield from _panel_faults(config)
    yield from _place_faults(config)
    yield from _scene_faults(config)
    for key, refreshes in _fault_refreshes(config.display.faults):
        if not all(text.isascii() and text.isdecimal() for text in refreshes):
            yield Fault((key,), f"{key}: refreshes are counted 0, 1, 2, ..., not {refreshes}")
    if config.rig.plane is not None:
        try:
            through(config.rig.plane, np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
        except ValueError as err:
            yield Fault(("rig.plane",), f"rig.plane: {err}")
        if config.rig.arrangement != "off-axis":
            yield Fault(
                ("rig.plane", "rig.arrangement"),
                'rig.plane: belongs to rig.arrangement = "off-axis"',
            )
    if config.camera.iso is not None and config.camera.iso < 1:
        yield Fault(("camera.iso",), f"camera.iso: must be at least 1, not {config.camera.iso}")
    yield from _plane_faults(config.display)
    mask = config.mask
    if config.camera.buckets == 2 and (mask.contrast is not None or mask.rise_s or mask.fall_s):
        yield Fault(
            ("camera.buckets", "mask.contrast", "mask.rise_s", "mask.fall_s"),
            "camera.buckets: a sensor of two buckets is its own mask, which switches at once and "
            "has no contrast, rise_s or fall_s",
        )
    settle_s, limit_s = config.rig.settle_s, config.limits.max_exposure_s
    if 2 * settle_s >= limit_s:
        yield Fault(
            ("rig.settle_s", "limits.max_exposure_s"),
            f"rig.settle_s: settling twice for {settle_s} s leaves nothing of "
            f"limits.max_exposure_s = {limit_s} s",
        )
    socket = config.server.socket
    if socket is not None and len(os.fsencode(socket)) > MAX_SOCKET_BYTES:
        yield Fault(
            ("server.socket",),
            f"server.socket: a unix socket's path has at most {MAX_SOCKET_BYTES} bytes: {socket}",
        )
    yield from _access_faults(config.server)
    yield from _truth_faults(config)


def _truth_faults(config: Config) -> Iterator[Fault]:
    """Yield what is wrong with the file that says what the mock bench really is."""
    if config.bench.truth is None:
        return
    try:
        faults = read_truth(Path(config.bench.truth), config)[1]
    except ConfigError as err:
        yield Fault(("bench.truth",), f"bench.truth: {err.message}")
        return
    for fault in faults:
        yield Fault(("bench.truth",), f"bench.truth: {config.bench.truth}: {fault.message}")


def _plane_faults(display: DisplayConfig) -> Iterator[Fault]:
    """Yield what is wrong with measured times of bit planes."""
    keys = ("display.plane_starts", "display.planes_per_refresh")
    starts, count = display.plane_starts, display.planes_per_refresh
    if not starts:
        return
    if count == 1 or len(starts) != count:
        yield Fault(keys, f"{keys[0]}: {len(starts)} times for {count} planes of a refresh")
        return
    low, high = (share / count for share in PLANE_TIMES)
    if not all(low <= share <= high for share in display.plane_shares):
        yield Fault(
            keys,
            f"{keys[0]}: each plane must begin after the one before, and last {low:.3g} to "
            f"{high:.3g} of a refresh",
        )


def _access_faults(server: ServerConfig) -> Iterator[Fault]:
    """Yield numbers that no user or group can have."""
    if any(uid < 0 for uid in server.allow_uids):
        yield Fault(("server.allow_uids",), "server.allow_uids: user ids are not negative")
    for name in ("look", "shoot", "administer"):
        role: RoleConfig = getattr(server, name)
        if any(uid < 0 for uid in role.uids):
            key = f"server.{name}.uids"
            yield Fault((key,), f"{key}: user ids are not negative")
        if any(isinstance(group, int) and group < 0 for group in role.groups):
            key = f"server.{name}.groups"
            yield Fault((key,), f"{key}: group ids are not negative")


def rate_fault(config: Config) -> Fault | None:
    """What to say of two refresh rates that cannot keep step; None when they can."""
    projector_hz, mask_hz = config.projector.refresh_hz, config.mask.refresh_hz
    if abs(projector_hz - mask_hz) <= RATE_TOLERANCE * projector_hz:
        return None
    return Fault(
        ("projector.refresh_hz", "mask.refresh_hz"),
        f"mask.refresh_hz: {mask_hz} differs from projector.refresh_hz = {projector_hz}; both "
        "panels need one rate to stay in lockstep",
    )


def _size_faults(config: Config) -> Iterator[Fault]:
    """Yield times, rates and f-numbers that no device has."""
    times = ("skew_s", "jitter_s", "scan_s", "rise_s", "fall_s", "lag_s")
    for name in ("projector", "mask", "trigger"):
        table = getattr(config, name)
        for key in times:
            value = getattr(table, key, 0.0)
            if math.isfinite(value) and abs(value) > LONGEST_S:
                yield Fault(
                    (f"{name}.{key}",),
                    f"{name}.{key}: {value:g} is more than {LONGEST_S:g} seconds, the unit of it",
                )
    numbers = {
        "projector.refresh_hz": (config.projector.refresh_hz, RATES_HZ),
        "mask.refresh_hz": (config.mask.refresh_hz, RATES_HZ),
        "camera.f_number": (config.camera.f_number, APERTURES),
    }
    for key, (number, (low, high)) in numbers.items():
        if isinstance(number, float) and math.isfinite(number) and not low <= number <= high:
            yield Fault((key,), f"{key}: must be from {low:g} to {high:g}, not {number:g}")


def _panel_faults(config: Config) -> Iterator[Fault]:
    """Yield what keeps the two panels from running in lockstep."""
    # Mock panels may slip: that is what they are for.
    if config.display.driver != "mock" and (fault := rate_fault(config)) is not None:
        yield fault
    if any(config.projector.offset_px):
        yield Fault(
            ("projector.offset_px",),
            "projector.offset_px: the mask is offset against the projector: set mask.offset_px",
        )
    yield from _field_faults(config)
    if config.projector.blur_px:
        yield Fault(
            ("projector.blur_px",),
            "projector.blur_px: what is blurred is the light on the mask: set mask.blur_px",
        )
    for name, panel in (("projector", config.projector), ("mask", config.mask)):
        if (fault := scan_fault(name, panel, config.rig.settle_s)) is not None:
            yield fault
        if abs(panel.phase_s) > 1.0 / panel.refresh_hz:
            yield Fault(
                (f"{name}.phase_s", f"{name}.refresh_hz"),
                f"{name}.phase_s: {panel.phase_s} s is more than one refresh",
            )
        if (fault := curve_fault(name, panel.lut)) is not None:
            yield fault
        if panel.contrast is not None and panel.contrast <= 1.0:
            yield Fault(
                (f"{name}.contrast",),
                f"{name}.contrast: white over black exceeds 1; leave it out for a perfect black",
            )


def _field_faults(config: Config) -> Iterator[Fault]:
    """Yield what is wrong with the part of the projector's picture that is the field."""
    if config.mask.field_px is not None:
        yield Fault(
            ("mask.field_px",),
            "mask.field_px: the field lies in the projector's picture: set projector.field_px",
        )
    if config.projector.field_px is None:
        return
    (left, top, wide, high), (width, height) = config.projector.field_px, config.projector.size_px
    if left + wide > width or top + high > height:
        yield Fault(
            ("projector.field_px", "projector.size_px"),
            f"projector.field_px: {wide} x {high} pixels at ({left}, {top}) are no part of the "
            f"projector's {width} x {height}",
        )


def _place_faults(config: Config) -> Iterator[Fault]:
    """Yield places on the field that no device can have."""
    tables = {name: getattr(config, name).place for name in ("projector", "mask", "camera")}
    wrong = {
        name: any(number_faults(msgspec.to_builtins(place), name)) for name, place in tables.items()
    }
    for name, why in place_faults(config):
        if not wrong[name]:  # numbers that are none have been told of
            keys = (f"{name}.place", f"{name}.place.map", f"{name}.size_px", "projector.size_px")
            yield Fault(keys, f"{name}.place: {why}")


def _scene_faults(config: Config) -> Iterator[Fault]:
    """Yield contradictions between the scene, its cells and the panels that show them."""
    scene = config.scene
    if scene.kind == "matrix" and scene.path is None:
        yield Fault(("scene.kind", "scene.path"), 'scene.path: needed by scene.kind = "matrix"')
    if scene.kind != "matrix" and scene.path is not None:
        yield Fault(
            ("scene.kind", "scene.path"),
            f'scene.path: belongs to scene.kind = "matrix", not to "{scene.kind}"',
        )
    if scene.path is not None and not Path(scene.path).is_file():
        yield Fault(("scene.path",), f"scene.path: there is no file {scene.path}")
    if config.schedule.cells is None and scene.grid is None and scene.kind == "matrix":
        return  # the cells are known only when the file is read
    rows, cols = config.code_grid()
    window = config.schedule.window
    guard = windows(window).guard
    # Half-cell shifts of a half-cell opening fall between the pixels of a smaller cell.
    needed_px, needed = (1.0 / guard, f" by the {window} window") if guard else (1.0, "")
    for name, small_px in small_cells(config, (rows, cols), needed_px):
        yield Fault(
            ("scene.grid", "schedule.window", f"{name}.size_px", f"{name}.place"),
            f"scene.grid: {rows} x {cols} cells leave {small_px:.3g} pixels a cell on the {name}; "
            f"{needed_px:g} are needed{needed}",
        )
    width, height = config.projector.field_size_px
    cell_px, offset_px = min(width / cols, height / rows), config.rig.misregistration_px
    if guard * cell_px < offset_px and guard:
        yield Fault(
            ("scene.grid", "schedule.window", "rig.misregistration_px", "projector.size_px"),
            f"schedule.window: the {window} window covers an offset up to {guard:g} of the "
            f"cell of {cell_px:.3g} pixels, not rig.misregistration_px = {offset_px:g}",
        )


def _fault_refreshes(faults: FaultsConfig) -> Iterator[tuple[str, list[str]]]:
    """Yield each list of [display.faults] with its refresh numbers as written."""
    yield "display.faults.late", list(faults.late)
    for key in ("dropped", "stale_mask", "stale_projector"):
        yield f"display.faults.{key}", [str(number) for number in getattr(faults, key)]
