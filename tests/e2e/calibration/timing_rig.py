"""A mock bench whose hidden truth is one of times, small enough to be calibrated in a second."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from pdcd.bench.measured import apply_calibration
from pdcd.bench.tables import Config, PanelConfig, SceneConfig
from pdcd.panels.schedule import SLOTS
from pdcd.probing.pulses import PanelResponse, compute_code_separation
from tests.e2e.calibration.steps_rig import make_config
from tests.taken import Calibrated, calibrate_once

REFRESH_S = 1.0 / 60.0
PROJECTOR_PX, MASK_PX, QUADS = (192, 96), (216, 120), (192, 120)
F_NUMBER = 22.0
"""At which about a hundred refreshes of white light are right: short photos, quickly made."""


def bench(folder: Path, truth: str, *, placed: bool = True, **panels: object) -> Config:
    """A bench before a card. placed : whether maps are known, as after the step of geometry.
    panels : more of [projector], which is believed and true."""
    config = make_config(
        folder, truth, projector_px=PROJECTOR_PX, mask_px=MASK_PX, quads=QUADS, placed=placed,
        camera={"f_number": F_NUMBER, "seed": 4}, scene=SceneConfig(kind="card", grid=(12, 16)),
    )  # fmt: skip
    projector = msgspec.structs.replace(config.projector, **panels)
    return msgspec.structs.replace(config, projector=projector)


def calibrated(config: Config, step: str) -> tuple[Calibrated, Config]:
    """How a step ended, and the configuration that came of it."""
    return calibrate_once(config, step), apply_calibration(config)


def late_s(panel: PanelConfig, rows: np.ndarray) -> np.ndarray:
    """When what a panel shows in some rows, 0 to 1 from its top, comes after it was sent, in s."""
    bands = panel.scan_bands
    part = np.floor(rows * bands) / max(bands - 1, 1)
    scan_s = panel.scan_s * part if panel.scan_s > 0 else -panel.scan_s * (1.0 - part)
    return np.asarray(panel.skew_s + scan_s)


def leaks_of(projector: PanelResponse, mask: PanelResponse, late_s: np.ndarray) -> dict[str, float]:
    """Light of a code in all others, over that of a refresh, by schedule; the mean of some lags."""
    found: dict[str, float] = {}
    for name in SLOTS:
        kept = [
            compute_code_separation(name, projector, mask, float(late), REFRESH_S)
            for late in late_s
        ]
        found[name] = float(np.mean([one.leak * one.light for one in kept]))
    return found
