"""Windows larger than half a cell: as much light as the misregistration allows, evenly."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, PanelConfig, RigConfig, SceneConfig
from pdcd.pictures.darkroom import Darkroom
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.record import Manifest
from tests import bench_rig
from tests.taken import Taken, started

pytestmark = pytest.mark.whole

GRID = (6, 8)
CELL_PX = 128
"""Projector pixels of a cell."""


def take(
    folder: Path,
    *,
    quads: int = 1,
    transport: np.ndarray | None = None,
    known_px: float = CELL_PX / 8 - 1.0,
    **fields: Any,
) -> tuple[np.ndarray, dict[str, Any], Manifest]:
    """The indirect picture (h, w, 3), the summary and the manifest of a bench whose mask is an
    eighth of a cell off."""
    scene = bench_rig.matrix_scene(folder, GRID)
    if transport is not None:
        path = folder / "even.npz"
        np.savez(path, transport=transport, grid=np.array(GRID))
        scene = SceneConfig(kind="matrix", path=str(path))
    config = bench_rig.config(
        folder,
        grid=GRID,
        scene=scene,
        camera=CameraConfig(noise="none", quads_per_cell=quads),
        mask=PanelConfig(size_px=(1024, 768), offset_px=(CELL_PX / 8, -CELL_PX / 16)),
        rig=RigConfig(misregistration_px=known_px),
    )
    asked = {"goal": "indirect", "codes": 64, "out": tempfile.mkdtemp(dir=folder), **fields}
    return photographed(config, msgspec.convert(asked, CaptureRequest))


def photographed(
    config: Config, asked: CaptureRequest
) -> tuple[np.ndarray, dict[str, Any], Manifest]:
    """The picture (h, w, 3) of what was asked for, the summary and the manifest."""
    with started(config) as engine:
        result = bench_rig.capture(engine, asked)
    made = Taken(result, engine)
    return made.picture(asked.goal), made.summary, made.manifest


@pytest.mark.parametrize(("window", "leaks"), [("side-5/8", False), ("side-7/8", True)])
def test_no_direct_light_gets_in_up_to_the_guard(window: str, leaks: bool, tmp_path: Path) -> None:
    _, summary, manifest = take(tmp_path, window=window, known_px=0.0)
    assert bool(manifest.realised["coded"]["diagonal_max"] > 0.0) is leaks
    folder = next(path.parent for path in tmp_path.glob("*/*/capture.json"))
    assert (bench_rig.cells_error(folder, taken_out=False) < 0.01) is not leaks
    # What is known to have got in is taken out.
    error = summary["rms_error_quads"]
    assert isinstance(error, float) and error < 0.01


@pytest.mark.long
def test_places_that_open_more_often_than_others_leave_no_trace(tmp_path: Path) -> None:
    """Windows overlap: places open 1, 2 or 4 times. Divided by that, an even scene is even."""
    cells = GRID[0] * GRID[1]
    even = 0.02 * np.ones((cells, cells)) + 0.5 * np.eye(cells)
    quads = 8
    picture, _, manifest = take(tmp_path, quads=quads, transport=even, window="side-3/4")
    inner = picture[2 * quads : -2 * quads, 2 * quads : -2 * quads]
    assert inner.shape == (2 * quads, 4 * quads, 3)
    (raw,) = [shot.raw for shot in manifest.run.shots if shot.name == "coded"]
    (folder,) = [path.parent.parent for path in tmp_path.rglob(Path(raw).name)]
    photo = Darkroom(folder, manifest.run).decoded().shots["coded"].light
    photo = photo[2 * quads : -2 * quads, 2 * quads : -2 * quads]
    assert photo.std() > 0.3 * photo.mean()
    assert inner.std() < 1e-3 * inner.mean()


@pytest.mark.parametrize(("apart", "seen"), [(1, 0.0), (2, 0.0), (3, 1.0)])
def test_the_border_of_a_radius_lies_between_cells(apart: int, seen: float, tmp_path: Path) -> None:
    """Each cell is lit by those that lie so many to its left, and by no other. Windows of quarters
    would let in a fourth of what the last cells within the radius send, and miss as much of the
    first beyond."""
    n = GRID[0] * GRID[1]
    left = np.arange(n) - apart
    left = np.where(np.arange(n) % GRID[1] >= apart, left, -1)
    transport = 0.3 * np.eye(n)
    transport[left >= 0, left[left >= 0]] = 0.1
    folder = tmp_path / "bench"
    folder.mkdir()
    np.savez(folder / "left.npz", transport=transport, grid=np.array(GRID))
    config = bench_rig.config(
        folder,
        grid=GRID,
        scene=SceneConfig(kind="matrix", path=str(folder / "left.npz")),
        mask=PanelConfig(size_px=(1024, 768)),
    )
    asked = CaptureRequest(
        goal="long-range", radius=2, codes=128, window="quarter", smooth=False, seed=3,
        out=tempfile.mkdtemp(dir=folder),
    )  # fmt: skip
    picture, _, _ = photographed(config, asked)
    quads = picture.shape[1] // GRID[1]
    assert np.allclose(picture[:, quads * apart :], 0.1 * seen, rtol=0.02, atol=1e-4)
