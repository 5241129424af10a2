"""Real windows, cable release and EOS body through the daemon, in real time.

The photo is held against ``(P o T) 1`` of the frame log, P by matrix exponentials pixel pair by
pixel pair (`tests.oracles`), and not by the code that makes and decodes photos.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.tables import PanelConfig, RigConfig
from pdcd.probing.panel import PanelOptics
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.folder import read_manifest
from pdcd.sensor.raw import read_raw
from tests import bench_rig, oracles, whole_rig, x11_rig
from tests.xserver import XServer

REQUEST = CaptureRequest(goal="indirect", codes=12, window="whole", white=False, black_level="none")
PRIMAL, DUAL = (
    PanelOptics(rise_s=0.001, fall_s=0.002),
    PanelOptics(rise_s=0.003, fall_s=0.005, leak=1 / 400),
)


@pytest.mark.whole
@pytest.mark.timeout(120)
def test_the_photo_is_that_of_the_frame_log(tmp_path: Path, x_quarter: XServer) -> None:
    projector = PanelConfig(
        size_px=x_quarter.projector_px, rise_s=PRIMAL.rise_s, fall_s=PRIMAL.fall_s
    )
    mask = PanelConfig(
        size_px=x_quarter.mask_px, rise_s=DUAL.rise_s, fall_s=DUAL.fall_s, contrast=400.0
    )
    rig_table = RigConfig(clock="real", on_miss="flag", settle_s=0.1)
    config = x11_rig.config(
        tmp_path, x_quarter, **whole_rig.tables(rig=rig_table, projector=projector, mask=mask)
    )
    with whole_rig.served(config) as rig:
        with rig.client() as client:
            result = client.capture(REQUEST)
        assert result.state == "done", result.error
        played = rig.engine._rig._context.shared.played
        assert played is not None
        frames, log = played
        (exposure,) = rig.body.shutter.exposures
        assert [e.level for e in rig.line.edges if e.line == "rts"].count(True) == 1
    folder = Path(str(result.folder))
    run = read_manifest(folder).run
    (shot,) = run.shots
    assert shot.source == "present-msc"

    # What the panels did while the blades were really open, which the drivers only bound.
    open_ns, close_ns = exposure.open_ns, exposure.close_ns
    assert open_ns <= shot.open_ns and close_ns <= shot.close_ns
    lit = oracles.timeline(frames, log, PRIMAL, open_ns, True, 1)
    seen = oracles.timeline(frames, log, DUAL, open_ns, False, 1)
    pairs = oracles.pair_integrals(lit, seen, PRIMAL, DUAL, (close_ns - open_ns) * 1e-9)
    photo = (pairs * bench_rig.transport()).sum(axis=1).reshape(bench_rig.GRID)

    raw = read_raw(folder / shot.raw)
    assert not raw.saturated.any()
    quads = config.camera.quads_per_cell
    per_cell = np.ones((quads, quads))
    gain = run.profile.row(shot.iso).gain_e_per_dn
    colours = zip(raw.planes, np.array(run.responsivity_e)[[0, 1, 1, 2]], strict=True)
    for plane, responsivity in colours:
        expected = np.kron(photo, per_cell) * responsivity / (gain * 8.0**2)
        assert expected.max() > 100.0
        np.testing.assert_allclose(plane, expected, atol=0.51)  # a file holds whole numbers
