"""Pictures as the scene really is, against sums over a dense matrix, quad by quad."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig
from pdcd.capture.worker.truths import compute_true_pictures
from pdcd.protocol.plan_summary import CaptureScheme
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.arrays import NO_ARRAYS, read_target
from pdcd.recipes.goals import check_target
from pdcd.recipes.make import make_recipe
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.scene.build import build_scene
from tests import bench_rig

GRID = bench_rig.GRID
T = bench_rig.transport()
OFF = T - np.diag(np.diag(T))
COLUMN = np.arange(T.shape[0]) % GRID[1]
STRIPES = np.stack([OFF @ (((COLUMN + step) % 4) < 2) for step in range(4)])
NEXT = np.array([T[n, n + 1] if n % GRID[1] < GRID[1] - 1 else 0.0 for n in range(len(T))])

WANTED: dict[str, tuple[dict[str, Any], dict[str, np.ndarray]]] = {
    "indirect": (
        {"goal": "indirect"},
        {"indirect": OFF.sum(axis=1), "white": T.sum(axis=1), "direct": np.diag(T)},
    ),
    "split": (
        {"goal": "split", "period": 4},
        {
            "high": STRIPES.max(axis=0) - STRIPES.min(axis=0),
            "low": 2.0 * STRIPES.min(axis=0),
            "indirect": OFF.sum(axis=1),
        },
    ),
    "fraction": (
        {"goal": "fraction", "p": 0.25},
        {"fraction": np.diag(T) + 0.25 * OFF.sum(axis=1)},
    ),
    "off-diagonal": ({"goal": "off-diagonal", "shift": (0, 1)}, {"off-diagonal": NEXT}),
}


@pytest.mark.parametrize("goal", WANTED)
def test_pictures_are_sums_over_the_matrix(goal: str, tmp_path: Path) -> None:
    fields, dense = WANTED[goal]
    camera = CameraConfig(frame_quads=(4 * GRID[1], 4 * GRID[0]))
    config = bench_rig.config(tmp_path, camera=camera)
    optics = OpticalBench(config, build_scene(config.scene), (4 * GRID[0], 4 * GRID[1]))
    request = msgspec.convert(fields, CaptureRequest)
    recipe = make_recipe(
        check_target(read_target(request, NO_ARRAYS, GRID)), CaptureScheme(codes=16)
    )
    found = compute_true_pictures(recipe, optics)
    assert set(found) == set(dense)
    for name, cells in dense.items():
        seen = cells.reshape(*GRID, 1).repeat(4, axis=0).repeat(4, axis=1)
        assert found[name] == pytest.approx(np.broadcast_to(seen, found[name].shape), abs=1e-9)
