"""What a rehearsal takes panels and sensor for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, PanelConfig
from pdcd.capture.engine import Engine
from pdcd.codes.make import make_codes
from pdcd.panels.schedule import build_frames
from pdcd.planning.outlook import RigSetting
from pdcd.planning.rehearse import _on_time, _variance
from pdcd.sensor.profile import expose_sensor
from pdcd.sensor.raw import to_rgb
from tests import bench_rig


@pytest.mark.parametrize("phase_s", [0.004, -0.004])
def test_the_panel_that_lags_is_later_in_the_foreseen_log(tmp_path: Path, phase_s: float) -> None:
    size = (1600, 1200)
    config = bench_rig.config(tmp_path, mask=PanelConfig(size_px=size, phase_s=phase_s % (1 / 60)))
    codes = make_codes("hadamard", bench_rig.GRID, 4, dual="complement")
    frames = build_frames(
        bench_rig.pairs(codes), bench_rig.GRID, window="whole", schedule="full", passes=1
    )
    log = _on_time(frames, config, 1000)
    np.testing.assert_allclose((log.dual_ns - log.primal_ns) * 1e-9, phase_s, atol=2e-9)
    assert (log.end_ns[1] - log.end_ns[0]) * 1e-9 == pytest.approx(phase_s, abs=2e-9)
    assert min(log.primal_ns[0], log.dual_ns[0]) == 1000


def test_the_foreseen_variance_is_the_spread_of_photos(tmp_path: Path) -> None:
    """Of red and blue one sample a quad, of green the mean of two."""
    config = bench_rig.config(tmp_path, camera=CameraConfig(noise="full"))
    engine = Engine.from_config(config)
    camera = engine._rig.look_at_camera()
    setting = RigSetting(config, camera, engine._profile)
    iso, f_number, seconds = 100, 8.0, 2.0
    quads = 200
    electrons = 9000.0
    light = electrons * f_number**2 / np.asarray(camera.responsivity_e)
    mosaic = np.full((2 * quads, 2 * quads), electrons)
    dn = expose_sensor(mosaic, setting.profile, iso, seconds, np.random.default_rng(1)).astype(
        np.float32
    )
    planes = np.stack([dn[0::2, 0::2], dn[0::2, 1::2], dn[1::2, 0::2], dn[1::2, 1::2]])
    gain = setting.profile.row(iso).gain_e_per_dn
    spread = to_rgb(planes).var(axis=(0, 1)) * (light * gain / electrons) ** 2
    foreseen = _variance(light[None, None], setting, iso, f_number, seconds)[0, 0]
    np.testing.assert_allclose(foreseen, spread, rtol=4 * np.sqrt(2 / quads**2))
