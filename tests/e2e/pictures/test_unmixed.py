"""Direct light that gets into a photo of indirect light, in whole captures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import (
    CameraConfig,
    Config,
    LimitsConfig,
    PanelConfig,
    RigConfig,
    SceneConfig,
)
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.truth import read_known_answer
from pdcd.words import WindowName
from tests.bench_rig import cells_error
from tests.taken import take

pytestmark = pytest.mark.whole

FREE = LimitsConfig(min_free_bytes=0)
WAYS: tuple[WindowName | None, ...] = (None, "quarter")


def test_direct_light_that_slow_panels_let_through_is_taken_out(tmp_path: Path) -> None:
    """Panels of milliseconds, known: what of the direct light gets into the photo is known, too."""
    config = Config(
        projector=PanelConfig(size_px=(256, 192), rise_s=3e-3, fall_s=3e-3, contrast=800.0),
        mask=PanelConfig(size_px=(400, 300), rise_s=4e-3, fall_s=6e-3, skew_s=4e-3, contrast=300.0),
        scene=SceneConfig(grid=(12, 16)),
        camera=CameraConfig(frame_quads=(80, 60), noise="none"),
        limits=FREE,
    )
    made = take(config, codes=64, window="quarter", black_level="none", out=str(tmp_path))
    assert cells_error(made.folder, taken_out=False) > 0.3
    assert cells_error(made.folder) < 0.02


def uneven(kind: str, **mask: Any) -> Config:
    """Cells of 21.3 pixels of the projector and 33.3 of the mask."""
    return Config(
        projector=PanelConfig(size_px=(85, 64)),
        mask=PanelConfig(size_px=(133, 100), **mask),
        scene=SceneConfig(kind=kind, grid=(3, 4)),
        camera=CameraConfig(quads_per_cell=4, noise="none"),
        rig=RigConfig(look_at_panels=False),  # in so few pixels
        limits=FREE,
    )


@pytest.mark.parametrize("kind", ["glass-and-balls", "open-book"])
def test_cells_that_do_not_end_with_the_panels_pixels_are_photographed_as_well(
    kind: str, tmp_path: Path
) -> None:
    """Glass loses light to quarter windows; a book has much more direct light than indirect, and
    fine print."""
    whole, quarter = (windowed_error(uneven(kind), way, tmp_path) for way in WAYS)
    assert whole < 0.02 and whole < 0.3 * quarter


def test_what_a_blurred_mask_lets_through_at_borders_is_taken_out_there(tmp_path: Path) -> None:
    """And nowhere else: as it was worked out for whole cells it was missing amid them."""
    assert windowed_error(uneven("open-book", blur_px=0.7), "whole", tmp_path) < 0.03


def windowed_error(config: Config, window: WindowName | None, folder: Path) -> float:
    """RMS error of an indirect photo through these windows, of the true picture's RMS."""
    made = take(config, codes=128, window=window, out=str(folder / str(window)))
    blurred = config.mask.blur_px > 0.0  # half of the picture is taken out then
    run = made.manifest.run
    assert {shot.window for shot in run.shots} == {"whole", window or "whole"}
    assert (run.borders is None) is (window == "quarter")
    decoded = Darkroom(made.folder, run).decoded()
    truth, seen = read_known_answer(made.folder, decoded.cells).on_quads(decoded.cells)
    error, true = ((image[seen] ** 2).mean() for image in (decoded.answer.image - truth, truth))
    assert made.quality.verdict == ("good", "doubtful")[blurred]
    return float(np.sqrt(error / true))
