"""Shots that measure black levels are dark frames of equal exposure and ISO, taken in the same run:
what the sensor adds to every photo, hot pixels too, goes with them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig
from pdcd.pictures.darkroom import Darkroom
from pdcd.runs.folder import read_manifest
from tests import bench_rig
from tests.taken import take

GRID = (12, 16)
"""Large enough for the mock's RAW files to be nothing but the mosaic."""


def capture(folder: Path, black_level: str) -> Path:
    config = bench_rig.config(folder, grid=GRID, camera=CameraConfig(noise="none", f_number=8.0))
    return take(config, codes=8, parts=1, pilot=0, black_level=black_level).folder


def add_to_every_raw(run: Path, dark: NDArray[np.uint16]) -> None:
    """As if the sensor had had it: into each file's samples, and the hash into the manifest."""
    path = run / "capture.json"
    manifest = json.loads(path.read_text())
    for shot in manifest["run"]["shots"]:
        raw = run / shot["raw"]
        data = bytearray(raw.read_bytes())
        samples = np.frombuffer(data, "<u2")[-dark.size :]  # a view of the file's bytes
        samples += dark.ravel()
        raw.chmod(0o644)
        raw.write_bytes(data)
        shot["sha256"] = hashlib.sha256(data).hexdigest()
    path.chmod(0o644)
    path.write_text(json.dumps(manifest))


def picture(run: Path) -> NDArray[np.float64]:
    decoded = Darkroom(run, read_manifest(run).run).decoded()
    return decoded.answer.image


@pytest.mark.parametrize("black_level", ["none", "mask", "both"])
def test_what_the_sensor_adds_to_every_photo_cancels(tmp_path: Path, black_level: str) -> None:
    run = capture(tmp_path, black_level)
    shots = json.loads((run / "capture.json").read_text())["run"]["shots"]
    assert len({shot["close_ns"] - shot["open_ns"] for shot in shots}) <= 2  # jitter apart
    before = picture(run)
    rng = np.random.default_rng(7)
    dark = rng.poisson(4.0, (2 * GRID[0], 2 * GRID[1])).astype(np.uint16)
    dark[rng.random(dark.shape) < 0.02] += 500  # hot pixels
    add_to_every_raw(run, dark)
    change = np.abs(picture(run) - before).max() / np.abs(before).max()
    if black_level == "none":
        assert change > 1e-2
    else:
        assert change < 1e-12
