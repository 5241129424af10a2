"""The golden test: the mock's photo is the realised probing matrix applied to the transport.

The oracle follows every pair of panel pixels by matrix exponentials and multiplies dense matrices;
it shares nothing with the code under test but what the panels were asked and did.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mock import MockBench
from pdcd.bench.devices import CameraSettings
from pdcd.bench.tables import Config
from pdcd.capture.rig import Rig
from pdcd.codes.make import make_codes
from pdcd.panels.frames import Frames
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import build_frames
from pdcd.probing.panel import PanelOptics
from pdcd.words import ScheduleName
from tests import bench_rig, oracles
from tests.places import DATA

AMBIENT = 0.03
FINE = 8
OFFSET_PX = (32.0, -64.0)
"""An eighth of a cell along columns, a quarter along rows, on the grid of 3 x 4 cells."""


def defective(folder: Path) -> Config:
    mask = bench_rig.DEFECTS["mask"]
    return bench_rig.with_defects(
        folder,
        scene=bench_rig.matrix_scene(folder, ambient=AMBIENT),
        mask=type(mask)(**{**{f: getattr(mask, f) for f in mask.__struct_fields__},
                           "offset_px": OFFSET_PX}),
    )  # fmt: skip


def expose(config: Config, frames: Frames) -> MockBench:
    rig = Rig(config)
    rig.connect()
    rig.display.load(frames)
    rig.readout.arm(CameraSettings(100, 8.0))
    rig.clock.sleep_until_ns(rig.shutter.open() + 50_000_000)
    rig.display.play(lambda *_: None, lambda: False)
    rig.clock.sleep_until_ns(rig.clock.now_ns() + 50_000_000)
    rig.shutter.close()
    return bench_rig.bench_of_rig(rig)


def dense_photo(bench: MockBench) -> NDArray[np.float64]:
    """``(Pi o T) 1`` plus ambient light, from dense matrices over all pairs of panel pixels."""
    assert bench.frames and bench.log and bench.open_ns is not None and bench.close_ns is not None
    frames, config = bench.frames, bench.config
    primal, dual = PanelOptics.from_config(config.projector), PanelOptics.from_config(config.mask)
    right, down = OFFSET_PX
    width, height = config.projector.size_px
    offset = (down * frames.grid[0] / height, right * frames.grid[1] / width)
    exposure_s = (bench.close_ns - bench.open_ns) * 1e-9
    lit = oracles.timeline(frames, bench.log, primal, bench.open_ns, True, FINE)
    seen = oracles.timeline(frames, bench.log, dual, bench.open_ns, False, FINE, offset)
    pairs = oracles.pair_integrals(lit, seen, primal, dual, exposure_s)
    cells, coaxial = oracles.to_cells(pairs, frames.grid, FINE)
    always = replace(primal, leak=1.0)
    opens = oracles.pair_integrals(lit, seen, always, dual, exposure_s)
    _, open_s = oracles.to_cells(opens, frames.grid, FINE)
    t = bench_rig.transport(frames.grid)
    off = t - np.diag(np.diag(t))
    photo = (cells * off).sum(axis=1) + coaxial * np.diag(t) + AMBIENT * open_s
    return np.asarray(photo)


@pytest.mark.parametrize("schedule", ["full", "none"])
@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_mock_photo_with_every_defect_on_equals_the_dense_evaluation(
    tmp_path: Path, window: str, schedule: ScheduleName
) -> None:
    codes = make_codes(
        "balanced", Lattice(bench_rig.GRID, window).shape, 8, dual="complement", seed=4
    )
    frames = build_frames(
        bench_rig.pairs(codes), bench_rig.GRID, window=window, schedule=schedule, passes=1
    )
    bench = expose(defective(tmp_path), frames)
    assert bench.log is not None
    if schedule == "full":
        assert bench.log.missed.sum() >= 5  # late by 2, dropped, stale twice: the faults were on
    got = bench.photo()
    want = dense_photo(bench)
    assert np.abs(got[:, 0] / want - 1.0).max() <= 1e-12
    np.testing.assert_array_equal(got[:, 0], got[:, 2])


@pytest.mark.parametrize("name", ["corner_32x24", "mirror_32x24"])
def test_path_traced_scene_with_instant_panels(name: str, tmp_path: Path) -> None:
    """Whole cells, ideal panels: the plain textbook sum over codes, to rounding."""
    data = np.load(DATA / f"{name}.npz")
    t, grid = data["transport"].astype(np.float64), (24, 32)
    codes = make_codes("hadamard", grid, 32, dual="complement", seed=1)
    frames = build_frames(bench_rig.pairs(codes), grid, window="whole", schedule="full", passes=1)
    scene = type(bench_rig.matrix_scene(tmp_path))(kind="matrix", path=str(DATA / f"{name}.npz"))
    bench = expose(bench_rig.config(tmp_path, scene=scene), frames)
    assert bench.log is not None
    mask, light = codes.dual.astype(float), codes.primal.astype(float)
    # The middle refresh of each code is the only one in which the mask is open.
    stamps = np.append(bench.log.dual_ns, bench.log.end_ns[1])
    shown_s = (np.diff(stamps) * 1e-9)[1::3]
    want = np.einsum("k,kn,kn->n", shown_s, mask, light @ t.T)
    np.testing.assert_allclose(bench.photo()[:, 1], want, rtol=1e-12, atol=0)
