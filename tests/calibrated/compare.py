"""What a calibration says of a bench, beside what the bench really is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.calibration import MAPS, Calibration
from pdcd.bench.placed import camera_map, panels_of
from pdcd.bench.tables import Config
from pdcd.maps.file import load_maps
from pdcd.maps.map import Map, between
from pdcd.sensor.profile import IsoRow

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
    found = _maps(load_maps(folder / MAPS), believed, true)
    for panel in ("projector", "mask"):
        for key in ("contrast", "rise_s", "fall_s"):
            name = f"{panel}.{key}"
            found[f"{name} share"] = _share(values.get(name), getattr(getattr(true, panel), key))
    found["blur share"] = _share(values.get("mask.blur_px"), true.mask.blur_px)
    found["shutter lag ms"] = 1e3 * abs(_number(values.get("trigger.lag_s")) - true.trigger.lag_s)
    for step in record.steps:
        for figure in step.figures:
            if figure.name == "scene.ambient":
                found["ambient share"] = _share(figure.value, true.scene.ambient)
            if figure.name == "sensor.gain_e_per_dn":
                found["gain share"] = _share(figure.value, sensor.gain_e_per_dn)
            if figure.name == "sensor.read_noise_e":
                found["read noise share"] = _share(figure.value, sensor.read_noise_e)
    found["lag ms"] = _lag_ms(values, true)
    return found


def _maps(maps: dict[str, Map], believed: Config, true: Config) -> dict[str, float]:
    """95th percentile, in projector pixels, of where maps say that things are."""
    panels = panels_of(true)
    quads = believed.camera.frame_quads
    assert quads is not None
    camera = camera_map(true, quads[::-1])
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
            between(maps["camera"], maps["projector"], on_camera), points
        ),
        "mask to projector px": _q95(between(maps["mask"], maps["projector"], on_mask), points),
    }


def _inside(points: Floats, size: tuple[int, int]) -> NDArray[np.bool_]:
    return np.asarray(((points > 0) & (points < size)).all(axis=-1))


def _q95(found: Floats, points: Floats) -> float:
    return float(np.percentile(np.hypot(*(found - points).T), 95.0))


def _lag_ms(values: dict[str, object], true: Config) -> float:
    """The largest error of the mask's lag behind the projector over bands of rows."""
    shares = (np.arange(BANDS) + 0.5) / BANDS
    wanted = _lags(
        true.mask.skew_s - true.projector.skew_s, true.mask.scan_s, true.projector.scan_s, shares
    )
    got = _lags(
        _number(values.get("mask.skew_s")) - _number(values.get("projector.skew_s", 0.0)),
        _number(values.get("mask.scan_s")),
        _number(values.get("projector.scan_s")),
        shares,
    )
    return float(1e3 * np.abs(got - wanted).max())


def _lags(skew_s: float, mask_scan_s: float, projector_scan_s: float, shares: Floats) -> Floats:
    return skew_s + (mask_scan_s - projector_scan_s) * shares


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


def _share(value: object, true: float) -> float:
    return abs(_number(value) / true - 1.0)
