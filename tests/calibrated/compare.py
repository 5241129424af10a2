"""What a calibration says of a bench, beside what the bench really is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.calibration import MAPS, Calibration
from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.bench.tables import Config, PanelConfig
from pdcd.panels.map import Map, map_between
from pdcd.panels.map_file import load_maps
from pdcd.probing.pulses import PanelResponse
from pdcd.sensor.profile import IsoRow
from tests.e2e.calibration.timing_rig import late_s, leaks_of

Floats = NDArray[np.float64]

POINTS = 40
MARGIN_PX = 20
"""Of the projector's picture: what lies nearer to its edge is not asked for."""
BANDS = 8
"""Bands of rows in which the mask's lag is compared."""


def compared(
    record: Calibration, folder: Path, believed: Config, true: Config, sensor: IsoRow
) -> dict[str, float]:
    """Errors by name, with the unit in the name; shares are of the true value."""
    values = {name: entry.value for name, entry in record.measured.items()}
    maps = load_maps(folder / MAPS)
    found = _maps(maps, believed, true)
    for panel in ("projector", "mask"):
        for key in ("contrast", "rise_s", "fall_s"):
            name = f"{panel}.{key}"
            found[f"{name} share"] = _share(values.get(name), getattr(getattr(true, panel), key))
    found["blur share"] = _share(values.get("mask.blur_px"), true.mask.blur_px)
    lag_s = _lag_of_exposures_s(record, believed, true)
    found["shutter lag ms"] = 1e3 * abs(_number(values.get("trigger.lag_s")) - lag_s)
    for step in record.steps:
        for figure in step.figures:
            if figure.name == "scene.ambient":
                found["ambient share"] = _share(figure.value, true.scene.ambient)
            if figure.name == "sensor.gain_e_per_dn":
                found["gain share"] = _share(figure.value, sensor.gain_e_per_dn)
            if figure.name == "sensor.read_noise_e":
                found["read noise share"] = _share(figure.value, sensor.read_noise_e)
    said_s, real_s = _lags_s(values, maps, true)
    found["lag ms"] = float(1e3 * np.abs(said_s - real_s).max())
    found["leak"] = _leak_off(values, said_s, real_s, true)
    return found


def _lag_of_exposures_s(record: Calibration, believed: Config, true: Config) -> float:
    """The mean lag of those exposures by which it was measured: the mock shutter draws two of them
    a photo. What jitter makes of the mean of ten is no error of the measurement."""
    before = 0
    for step in record.steps:
        photos = [photo.name for photo in step.photos]
        if step.name == "shutter":
            bars = [before + number for number, name in enumerate(photos) if "bar" in name]
            count = 2 * (bars[-1] + 1)
            drawn = np.random.default_rng([believed.camera.seed, 2]).standard_normal(count)
            late = drawn[[2 * photo + side for photo in bars for side in (0, 1)]]
            return float(true.trigger.lag_s + true.trigger.jitter_s * late.mean())
        before += len(photos)
    return float("nan")


def _maps(maps: dict[str, Map], believed: Config, true: Config) -> dict[str, float]:
    """95th percentile, in projector pixels, of where maps say that things are."""
    panels = panels_of(true)
    quads = believed.camera.frame_quads
    assert quads is not None
    camera = make_camera_map(true, quads[::-1])
    width, height = believed.projector.size_px
    across = np.linspace(MARGIN_PX, width - MARGIN_PX, POINTS)
    down = np.linspace(MARGIN_PX, height - MARGIN_PX, POINTS)
    points = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    field = panels.projector.map.to_field(points)
    on_mask, on_camera = panels.mask.map.from_field(field), camera.from_field(field)
    seen = _inside(on_mask, believed.mask.size_px) & _inside(on_camera, quads)
    points, on_mask, on_camera = points[seen], on_mask[seen], on_camera[seen]
    return {
        "camera to projector px": _q95(
            map_between(maps["camera"], maps["projector"], on_camera), points
        ),
        "mask to projector px": _q95(map_between(maps["mask"], maps["projector"], on_mask), points),
    }


def _inside(points: Floats, size: tuple[int, int]) -> NDArray[np.bool_]:
    return np.asarray(((points > 0) & (points < size)).all(axis=-1))


def _q95(found: Floats, points: Floats) -> float:
    return float(np.percentile(np.hypot(*(found - points).T), 95.0))


def _lags_s(values: dict[str, object], maps: dict[str, Map], true: Config) -> tuple[Floats, Floats]:
    """The mask's lag behind the projector, as said and as it is, (BANDS,) each: over bands of rows
    of the projector, the mean of what lies in it. What the display is told to delay is in it."""
    panels = panels_of(true)
    width, height = true.projector.size_px
    across = np.linspace(MARGIN_PX, width - MARGIN_PX, POINTS)
    down = (np.arange(BANDS * POINTS) + 0.5) * height / (BANDS * POINTS)
    points = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    on_mask = panels.mask.map.from_field(panels.projector.map.to_field(points))
    seen = _inside(on_mask, true.mask.size_px)
    real = _late(true.mask, on_mask) - _late(true.projector, points)
    found = [
        PanelConfig(
            size_px=size_px,
            skew_s=_number(values.get(f"{panel}.skew_s", 0.0)),
            scan_s=_number(values.get(f"{panel}.scan_s", 0.0)),
            scan_bands=round(_number(values.get(f"{panel}.scan_bands", 1))),
        )
        for panel, size_px in (("projector", true.projector.size_px), ("mask", true.mask.size_px))
    ]
    said = _late(found[1], map_between(maps["projector"], maps["mask"], points))
    said = said - _late(found[0], points)
    delay = round(_number(values.get("display.mask_delay_refreshes", 0)))

    def of_bands(late: Floats) -> Floats:
        mean = np.nanmean(np.where(seen, late, np.nan).reshape(BANDS, -1), axis=1)
        return np.asarray(mean + delay / true.projector.refresh_hz)

    return of_bands(said), of_bands(real)


def _leak_off(values: dict[str, object], said_s: Floats, real_s: Floats, true: Config) -> float:
    """The largest error of the leak of any schedule, the mean over all bands."""
    said = [
        PanelResponse(*(_number(values.get(f"{panel}.{key}")) for key in ("rise_s", "fall_s")))
        for panel in ("projector", "mask")
    ]
    real = [PanelResponse(panel.rise_s, panel.fall_s) for panel in (true.projector, true.mask)]
    found, wanted = leaks_of(said[0], said[1], said_s), leaks_of(real[0], real[1], real_s)
    return max(abs(found[name] - wanted[name]) for name in wanted)


def _late(panel: PanelConfig, points: Floats) -> Floats:
    """When what a panel shows at points of it comes, after it was sent, in s."""
    return late_s(panel, np.clip(points[:, 1] / panel.size_px[1], 0.0, 1.0 - 1e-9))


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


def _share(value: object, true: float) -> float:
    return abs(_number(value) / true - 1.0)
