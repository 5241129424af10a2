"""The virtual bench of the figures: the paper's hardware, as it is believed and as it really is.

A projector of 1024 x 768 and an LCD mask of 1600 x 1200 pixels at 60 Hz, behind them a camera like
the paper's. No two devices share a grid: the camera stands a little askew behind its lens, the mask
is turned and larger than the field. The truth differs from what is believed as after a calibration
by hand: the mask is 2 projector pixels off, the lens softer, the panels slower. The paper's codes
tolerate 4 pixels, a quarter of a cell.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from pdcd.bench.reading import TOML_TIME_TYPES, format_toml
from pdcd.bench.tables import (
    BenchConfig,
    CalibrationConfig,
    CameraConfig,
    Config,
    LimitsConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
    ServerConfig,
)
from pdcd.bench.truth import BenchTruth, TrueCamera, TruePanel, TrueSensor
from pdcd.figures.figure import PAPER_PROFILE, FigureMode, FigureTake
from pdcd.panels.map import to_map_matrix
from pdcd.panels.placing import Placing
from pdcd.sensor.profile import load_profile, responsivity_e

PROJECTOR_PX, _MASK_PX = (1024, 768), (1600, 1200)
_FILLED = 0.94
"""Share of the frame's height that the field fills."""
_CAMERA_TURN_DEG, _MASK_TURN_DEG, _MASK_SCALE = -1.2, 0.3, 1.02
_LENS = (0.008, 0.0)
_BLUR_QUADS = 0.5
_SAMPLES = 2
"""Points along either side of a quad at which the light is sampled."""
_PROJECTOR: dict[str, Any] = {
    "skew_s": 4e-4,
    "rise_s": 1.5e-3,
    "fall_s": 2.2e-3,
    "contrast": 1500.0,
}
_MASK: dict[str, Any] = {"skew_s": 2e-3, "rise_s": 2e-3, "fall_s": 3e-3, "contrast": 400.0}
"""Panels as they were measured. A slower mask would still be open when the next code is lit."""
_REMAINDER_PX = 4.0
"""Largest misregistration that the bench is believed to have, in projector pixels."""

_TRUE_CAMERA_TURN_DEG, _TRUE_CAMERA_SHIFT_PX = 0.02, (0.3, -0.2)
_TRUE_MASK_TURN_DEG, _TRUE_MASK_OFFSET_PX = 0.01, (1.6, -1.1)
"""Differences of the truth from what is believed."""
BORDER_PX = 2.0
"""Border of the field in which nothing is compared, in projector pixels. The panels are misplaced
by about half of that, so that along one side the mask is closed where the projector is lit. The
camera's quads resolve this line, and it would be most of the error of a good photo."""


def make_figure_config(take: FigureTake, mode: FigureMode, folder: Path) -> Config:
    """The configuration of a capture, whose runs and whose truth go below `folder`."""
    grid = take.grid or mode.grid
    scene = SceneConfig(kind=take.scene, grid=grid, options=dict(take.options))
    rig = RigConfig(
        name="figures",
        arrangement="off-axis" if take.off_axis else "coaxial",
        misregistration_px=0.0 if take.perfect else _REMAINDER_PX,
    )
    config = Config(
        rig=rig,
        scene=scene,
        camera=CameraConfig(
            profile=mode.profile,
            frame_quads=mode.quads,
            place=_camera(mode.quads, 0.0, (0.0, 0.0)),
            blur_quads=_BLUR_QUADS,
            f_number=_find_aperture(take.f_number, mode.profile),
        ),
        projector=PanelConfig(size_px=PROJECTOR_PX, **({} if take.perfect else _PROJECTOR)),
        mask=(
            PanelConfig(size_px=_MASK_PX)
            if take.perfect
            else PanelConfig(size_px=_MASK_PX, place=_mask(0.0), **_MASK)
        ),
        calibration=CalibrationConfig(use="none"),
        limits=LimitsConfig(min_free_bytes=0, max_exposure_s=3600.0),
        server=ServerConfig(state_dir=str(folder)),
    )
    if take.perfect:
        return config
    path = folder / "truth.toml"
    path.write_text(
        format_toml(msgspec.to_builtins(_truth(mode), builtin_types=TOML_TIME_TYPES), {})
    )
    return msgspec.structs.replace(config, bench=BenchConfig(truth=str(path)))


def _find_aperture(f_number: float | None, profile: str) -> float | Literal["auto"]:
    """The aperture that fills a sensor as much as `f_number` fills the paper's; "auto" for None."""
    if f_number is None:
        return "auto"
    fills = []
    for body in (load_profile(profile), load_profile(PAPER_PROFILE)):
        row = body.rows[0]
        full_e = body.saturation_dn(row.iso) * row.gain_e_per_dn
        fills.append(float(responsivity_e(CameraConfig(), body.colours).max()) / full_e)
    return f_number * math.sqrt(fills[0] / fills[1])


def count_equal_photos(profile: str) -> int:
    """Photos by a sensor that match one photo by the paper's: together a full pixel has no more
    photon and read noise, relative to its light and averaged over its colours."""
    return math.ceil(_relative_variance(profile) / _relative_variance(PAPER_PROFILE))


def _relative_variance(profile: str) -> float:
    """Relative variance of a pixel whose brightest sample is full: variance over light squared,
    averaged over its colours."""
    body = load_profile(profile)
    row, of_unit = body.rows[0], responsivity_e(CameraConfig(), body.colours)
    full_e = body.saturation_dn(row.iso) * row.gain_e_per_dn
    light_e = full_e * of_unit / of_unit.max()
    samples = np.array([1, 2, 1] if body.colours == 3 else [1])
    return float(np.mean((light_e + row.read_noise_e**2) / light_e**2 / samples))


def _truth(mode: FigureMode) -> BenchTruth:
    """What the bench really is."""
    return BenchTruth(
        projector=TruePanel(skew_s=0.0005, rise_s=0.00152, fall_s=0.0022, contrast=1400.0),
        mask=TruePanel(
            skew_s=0.0021,
            rise_s=0.00202,
            fall_s=0.00306,
            contrast=420.0,
            offset_px=_TRUE_MASK_OFFSET_PX,
            place=_mask(_TRUE_MASK_TURN_DEG),
        ),
        camera=TrueCamera(
            place=_camera(mode.quads, _TRUE_CAMERA_TURN_DEG, _TRUE_CAMERA_SHIFT_PX),
            blur_quads=1.2 * _BLUR_QUADS,
            samples=_SAMPLES,
        ),
        sensor=TrueSensor(read_noise=1.1, prnu=0.004),
    )


def _mask(more_deg: float) -> Placing:
    return Placing(turn_deg=_MASK_TURN_DEG + more_deg, scale=_MASK_SCALE)


def _camera(quads: tuple[int, int], more_deg: float, shift_px: tuple[float, float]) -> Placing:
    """A frame of square quads, a little turned; the field fills most of its height.

    shift_px : of the camera's picture on the field, in projector pixels.
    """
    width, height = PROJECTOR_PX
    px_per_quad = height / (_FILLED * quads[1])
    angle = math.radians(_CAMERA_TURN_DEG + more_deg)
    turned = px_per_quad * np.array(
        [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    )
    whole = np.eye(3)
    whole[:2, :2] = turned
    middle = np.array([width, height]) / 2.0 + shift_px
    whole[:2, 2] = middle - turned @ (np.array(quads) / 2.0)
    to_field = np.diag([1.0 / width, 1.0 / height, 1.0]) @ whole
    return Placing(homography=to_map_matrix(to_field), radial=_LENS)
