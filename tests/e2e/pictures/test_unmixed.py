"""Direct light that gets into a photo of indirect light, in whole captures."""

from __future__ import annotations

from pathlib import Path

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig, PanelConfig, SceneConfig
from pdcd.protocol.request import CaptureRequest
from tests.bench.captures import capture_with, opened
from tests.bench_rig import cells_error


def test_direct_light_that_slow_panels_let_through_is_taken_out(tmp_path: Path) -> None:
    """Panels of milliseconds, known: what of the direct light gets into the photo is known, too."""
    config = Config(
        projector=PanelConfig(size_px=(256, 192), rise_s=3e-3, fall_s=3e-3, contrast=800.0),
        mask=PanelConfig(size_px=(400, 300), rise_s=4e-3, fall_s=6e-3, skew_s=4e-3, contrast=300.0),
        scene=SceneConfig(grid=(12, 16)),
        camera=CameraConfig(frame_quads=(80, 60), noise="none"),
        limits=LimitsConfig(min_free_bytes=0),
    )
    request = CaptureRequest(goal="indirect", codes=64, window="quarter", black_level="none")
    with opened(config) as engine:
        result = capture_with(engine, request, tmp_path, "job")
    assert result.folder is not None
    folder = Path(result.folder)
    assert cells_error(folder, taken_out=False) > 0.3
    assert cells_error(folder) < 0.02
