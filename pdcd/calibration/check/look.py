"""A snapshot of the bench: the photos of a check, what they say, and how that is kept."""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.calibration.check.changes import BenchSnapshot, average_parts, measure_closed_mask
from pdcd.calibration.check.moved import MapDrift, fit_map_drift
from pdcd.calibration.geometry.dots import DotGrid
from pdcd.calibration.geometry.finding import find_known_dots
from pdcd.calibration.geometry.geometry_step import make_dot_grids
from pdcd.calibration.geometry.panel_map import quads_across_px
from pdcd.calibration.photo import QuadPhoto
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    PhotoRequest,
    UserPrompt,
    take_photo,
)
from pdcd.calibration.shown import PanelSequence, make_still_sequence
from pdcd.calibration.timing.delayed import undo_mask_shift
from pdcd.calibration.timing.programmes import (
    BLACKS,
    PULSES,
    WHITES,
    make_pulse_strips,
    make_strip_sequence,
)
from pdcd.calibration.timing.strips import read_strips
from pdcd.calibration.timing.timing_fit import TimingFitter
from pdcd.calibration.timing.timing_model import PanelTimes, StripModel, Tail
from pdcd.calibration.window import find_shared_window
from pdcd.errors import CalibrationError
from pdcd.panels.frames import BLACK, WHITE
from pdcd.panels.map import Map, map_between

_Arrays = Mapping[str, NDArray[Any]]

_LEAST_LIGHT = 1e-3
"""Largest strip over white, below which no strip was lit."""
_DOTS_END = 1.75
"""Radii from the middle of a dot at which its light has ended; dots are five radii apart."""


@dataclass(frozen=True)
class SnapshotExposure:
    """How a snapshot is taken; f_number is None where the lens is not set from here."""

    iso: int
    f_number: float | None
    refreshes: int

    def take(
        self, session: CalibrationSession, shown: PanelSequence
    ) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, CalibrationPhoto]:
        """Take one photo with these settings."""
        wanted = PhotoRequest(session.in_step(shown), self.iso, self.f_number)
        return (yield from take_photo(wanted))


def take_snapshot(
    session: CalibrationSession, exposure: SnapshotExposure
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, tuple[BenchSnapshot, str]]:
    """Take four photos, and one of strips where the timing was measured. Returns what they say, and
    why the lag is not known where it is not."""
    projector, mask, camera = (session.found(name) for name in ("projector", "mask", "camera"))
    refreshes = exposure.refreshes
    shown = make_still_sequence("white", refreshes, WHITE, WHITE)
    taken = yield from exposure.take(session, shown)
    white, said = session.photo(taken), taken.seen
    shown = make_still_sequence("room", refreshes, BLACK, WHITE)
    room = session.photo((yield from exposure.take(session, shown)))
    of_projector, of_mask = make_dot_grids(session)
    sigma_px = 1.0 / quads_across_px(projector, camera)

    shown = make_still_sequence("dots-projector", refreshes, of_projector.dots(), WHITE)
    photo = session.photo((yield from exposure.take(session, shown)))
    index, quads, sigma = _again(white, photo, of_projector, projector, camera)
    seen = map_between(camera, projector, quads)
    bumped = fit_map_drift(projector.size_px, seen, of_projector.centres(index), sigma_px * sigma)
    camera = camera.then(bumped.of_field)

    shown = make_still_sequence("dots-mask", refreshes, WHITE, of_mask.dots())
    photo = session.photo((yield from exposure.take(session, shown)))
    index, quads, sigma = _again(white, photo, of_mask, mask, camera)
    believed = map_between(mask, projector, of_mask.centres(index))
    seen = map_between(camera, projector, quads)
    apart = fit_map_drift(projector.size_px, believed, seen, sigma_px * sigma)
    # Dots that were not found count too: their light does not come through black.
    places = map_between(mask.then(apart.of_field), camera, of_mask.centres(_all(of_mask)))
    closed = measure_closed_mask(
        photo.main, photo.main_variance, white.main,
        places[np.isfinite(places).all(axis=-1)],
        _DOTS_END * of_mask.radius_px * quads_across_px(mask, camera),
    )  # fmt: skip

    why, lag = "", None
    if "timing.lag_s" in session.arrays:
        strips = yield from _strips(session, exposure, (white, room), camera)
        try:
            lag = _lag(session, *strips)
        except CalibrationError as err:
            lag, why = (np.nan, np.nan), f"{err.message}: {err.hint}"
    open_s = refreshes * session.refresh_s
    light = average_parts(white.main - room.main) / open_s
    saturated = white.saturated_share(white.main > 0.25 * light.max() * open_s)
    settings = _settings(session, exposure, said.iso, said.f_number)
    return BenchSnapshot(bumped, apart, light, closed, lag, settings, saturated), why


def pack_snapshot(seen: BenchSnapshot, exposure: SnapshotExposure) -> dict[str, NDArray[Any]]:
    """A snapshot as arrays."""
    taken = [exposure.iso, exposure.f_number or 0.0, exposure.refreshes]
    arrays: dict[str, NDArray[Any]] = {
        "check.camera": seen.camera.array,
        "check.mask": seen.mask.array,
        "check.white": seen.white,
        "check.closed": np.array(seen.closed),
        "check.settings": np.frombuffer(
            json.dumps(seen.settings, sort_keys=True).encode(), dtype=np.uint8
        ),
        "check.exposure": np.array(taken, dtype=np.float64),
    }
    if seen.lag_s is not None and np.isfinite(seen.lag_s).all():
        arrays["check.lag_s"] = np.array(seen.lag_s)
    return arrays


def unpack_snapshot(
    arrays: _Arrays, size_px: tuple[int, int]
) -> tuple[BenchSnapshot, SnapshotExposure] | None:
    """A snapshot that was kept, and how it was taken; None where none was kept. All arrays from a
    file are float64. size_px : of the projector."""
    if "check.camera" not in arrays:
        return None
    iso, f_number, refreshes = arrays["check.exposure"].tolist()
    closed, sigma = arrays["check.closed"].tolist()
    lag = arrays["check.lag_s"].tolist() if "check.lag_s" in arrays else None
    then = BenchSnapshot(
        MapDrift.kept(size_px, arrays["check.camera"]),
        MapDrift.kept(size_px, arrays["check.mask"]),
        arrays["check.white"],
        (closed, sigma),
        lag and (lag[0], lag[1]),
        json.loads(arrays["check.settings"].astype(np.uint8).tobytes()),
    )
    return then, SnapshotExposure(int(iso), f_number or None, int(refreshes))


def _again(
    white: QuadPhoto, photo: QuadPhoto, grid: DotGrid, panel: Map, camera: Map
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Index, places in quads and their sigma of the dots that are found again."""
    index = _all(grid)
    quads = map_between(panel, camera, grid.centres(index))
    with np.errstate(invalid="ignore"):
        inside = ((quads > 0.0) & (quads < camera.size_px)).all(axis=-1)
    index, quads, sigma = find_known_dots(white, photo, grid, index[inside], quads[inside])
    return index, quads, np.hypot(*sigma.T) / np.sqrt(2.0)


def _all(grid: DotGrid) -> NDArray[np.int64]:
    rows, cols = grid.shape
    return np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1).reshape(-1, 2)


def _lag(session: CalibrationSession, model: StripModel, times: PanelTimes) -> tuple[float, float]:
    """How much later the mask is than when its lag was measured, and sigma. Raises
    CalibrationError."""
    if not float(model.readings[0].value.max()) > _LEAST_LIGHT:
        raise CalibrationError(
            "the timing strips are black",
            device="display",
            hint="check that both panels show their strips",
        )
    return TimingFitter(model).later(times)


def _strips(
    session: CalibrationSession,
    exposure: SnapshotExposure,
    white_and_room: tuple[QuadPhoto, QuadPhoto],
    camera: Map,
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, tuple[StripModel, PanelTimes]]:
    """A model of the strips' readings, and the times that were calibrated."""
    arrays, (projector, mask) = session.arrays, (session.found("projector"), session.found("mask"))
    lags = arrays["timing.lag_s"]
    strips = make_pulse_strips(
        projector, 0, (*PULSES, WHITES, BLACKS), find_shared_window(mask, camera)
    )
    periods = exposure.refreshes // strips.programmes[0].of
    shown = make_strip_sequence("strips", strips, projector, mask, white=False, periods=periods)
    taken = yield from exposure.take(session, shown)
    ran = undo_mask_shift(taken.ran, session.behind_rows, shown.refreshes)
    (white, room), photo = white_and_room, session.photo(taken)
    read = read_strips(photo, white, camera, strips, bands=lags.size, gaps=False, room=room)
    on_mask, tail_share, slower = arrays.get("timing.tail", np.array([0.0, 0.0, 1.0]))
    tail = Tail(bool(on_mask), float(tail_share), float(slower)) if tail_share else None
    across_s = float(arrays.get("timing.across_s", 0.0))
    times = PanelTimes(arrays["timing.taus_s"], arrays["timing.leaks"], lags, tail, across_s)
    model = StripModel([read], [ran], session.refresh_s)
    model.slope_s = float(np.polyfit(read.bands, lags, 1)[0]) if lags.size > 1 else 0.0
    return model, times


def _settings(
    session: CalibrationSession, exposure: SnapshotExposure, told_iso: int, told_f: float | None
) -> dict[str, str]:
    """What must not change from a calibration to a session."""
    camera, fixed = session.camera, session.config.camera.f_number
    f_number = exposure.f_number if fixed == "auto" else fixed
    width, height = session.found("camera").size_px
    return {
        "camera": f"{camera.model} {camera.serial}".strip(),
        "iso": str(session.iso),
        "iso by the file": str(told_iso or exposure.iso),
        "f_number": f"{f_number or 0.0:g}",
        "f_number by the file": f"{told_f or 0.0:.3g}",
        "frame": f"{width} x {height} pixels",
    }
