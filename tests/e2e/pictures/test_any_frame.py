"""Every goal on a camera that is turned, and whose frame no grid divides, through RAW files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig, PanelConfig
from pdcd.capture.engine import Engine
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.pictures.decode import decode_folder
from pdcd.pictures.written.picture_files import read_tiff
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.folder import read_manifest
from pdcd.sensor.cells import CellMap
from tests import bench_rig
from tests.sampled import sampled
from tests.soak import wanted
from tests.taken import take_with

pytestmark = pytest.mark.whole

FRAME = (51, 70)
PLACE = Placing(turn_deg=7.0, scale=1.1)
PROJECTOR_PX, MASK_PX = (256, 192), (400, 300)
"""Small panels: 16 pixels to a cell and more, so that few lie on the edge of two."""
CELLS = CellMap(
    grid=wanted.GRID,
    frame=FRAME,
    map=make_placed_map(PLACE, (FRAME[1], FRAME[0]), PROJECTOR_PX, "camera"),
)
LOOSE = {"short-range": 0.1, "nayar": 0.2, "split": 0.3, "multi-image": 0.4}
"""Share by which a goal may differ: what is no sum of photos under one weight does, where quads see
two cells."""
REQUESTS = [r for r in wanted.requests(16) if r.goal not in ("white", "transport")]
"""Entries of the transport matrix have a page of tests of their own."""


def named(request: CaptureRequest) -> str:
    given = msgspec.to_builtins(request)
    return "-".join(str(given[k]) for k in ("goal", "method", "family", "window") if given.get(k))


@pytest.fixture(scope="module")
def engines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Engine, Engine]]:
    """With one quad a cell, and with the turned camera."""
    made = []
    turned = CameraConfig(noise="none", place=PLACE, frame_quads=(FRAME[1], FRAME[0]))
    panels = {
        "projector": PanelConfig(size_px=PROJECTOR_PX),
        "mask": PanelConfig(size_px=MASK_PX),
    }
    for name, camera in (("aligned", CameraConfig(noise="none")), ("turned", turned)):
        folder = tmp_path_factory.mktemp(name)
        config = bench_rig.config(folder, grid=wanted.GRID, camera=camera, **panels)
        engine = Engine.from_config(config)
        engine.start()
        made.append(engine)
    yield made[0], made[1]
    for engine in made:
        engine.stop()


def taken(engine: Engine, request: CaptureRequest, job: str) -> Path:
    return take_with(engine, job, **msgspec.to_builtins(request)).folder


def probe(folder: Path) -> dict[str, NDArray[Any]]:
    with np.load(folder / "probe.npz") as data:
        return dict(data)


@pytest.mark.parametrize("request_", sampled(REQUESTS, 10), ids=named)
def test_every_goal_is_the_same_on_a_turned_camera(
    engines: tuple[Engine, Engine],
    request_: CaptureRequest,
) -> None:
    job = str(REQUESTS.index(request_))
    aligned = probe(taken(engines[0], request_, job))
    folder = taken(engines[1], request_, job)
    found = probe(folder)
    assert found["image"].shape == (*wanted.GRID, 3)
    name = "high" if request_.goal == "split" else request_.goal
    image = read_tiff(folder / "linear" / f"{name}.tif")
    assert image.shape == (*FRAME, 3)
    expected = CELLS.spread(aligned["image"].reshape(-1, 3))
    known = CELLS.known
    error = np.sqrt(np.mean((image - expected)[known] ** 2) / np.mean(expected[known] ** 2))
    loose = LOOSE.get(request_.method or request_.goal, LOOSE.get(request_.goal, 0.05))
    assert error < loose
    assert not image[~known].any()
    mean = CELLS.mean(expected)
    off = np.abs(found["image"].reshape(-1, 3) - mean).max() / np.abs(mean).max()
    assert off < loose


@pytest.mark.long
def test_runs_decode_the_same_again(engines: tuple[Engine, Engine]) -> None:
    request = CaptureRequest(goal="indirect", codes=16, parts=4, window="quarter")
    folder = taken(engines[1], request, "again")
    cells = read_manifest(folder).run.cells
    assert cells == CELLS
    assert decode_folder(folder).identical
    found = probe(folder)
    assert np.isfinite(found["sigma"]).any()
    unseen = ~CELLS.seen().reshape(wanted.GRID)
    assert np.isinf(found["sigma"][unseen]).all() and not found["image"][unseen].any()
