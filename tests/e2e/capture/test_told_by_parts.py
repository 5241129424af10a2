"""The parts of a capture tell how much smooth light it holds: less error, and bars that know."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pdcd
from pdcd.bench.tables import CameraConfig, SceneConfig
from pdcd.panels.placing import Placing
from pdcd.pictures import bars
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.photos import NO_SMOOTH_MODELS
from tests import bench_rig, taken
from tests.taken import Taken, relative_rms

pytestmark = pytest.mark.whole

GRID = (12, 16)


def take(folder: Path, goal: str, **fields: Any) -> Taken:
    config = bench_rig.config(
        folder,
        grid=GRID,
        scene=SceneConfig(kind="wax-disk", grid=GRID),
        camera=CameraConfig(noise="none", **fields.pop("camera", {})),
    )
    return taken.take(config, goal=goal, **{"codes": 32, "parts": 4, **fields})


def over_known_cells(made: Taken) -> float:
    """RMS error of a run that is decoded now, over the cells whose truth is known."""
    image = Darkroom(made.folder, made.manifest.run).decoded().cell_means.image
    truth = pdcd.open(made.folder).truth
    assert truth is not None
    known = np.isfinite(truth)
    return relative_rms(image[known], truth[known])


@pytest.mark.parametrize(
    ("goal", "fields", "most"),
    [
        ("indirect", {}, 0.7),
        ("indirect", {"camera": {"frame_quads": (48, 36), "place": Placing(scale=0.8)}}, 0.85),
        ("long-range", {"radius": 2, "codes": 128, "pilot": 0}, 0.85),
        pytest.param("indirect", {"camera": {"quads_per_cell": 3}}, 0.7, marks=pytest.mark.long),
    ],
)
def test_smooth_light_is_corrected_by_what_parts_tell(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    goal: str,
    fields: dict[str, Any],
    most: float,
) -> None:
    made = take(tmp_path, goal, **fields)
    assert made.decodes_the_same()
    with np.load(made.folder / "truth.npz") as known:
        light = float(np.sqrt(np.mean(known["image"] ** 2)))
    sigma = float(np.sqrt(np.mean(made.probe["sigma_code"] ** 2)))
    assert 0.6 < sigma / (made.error * light) < 2.0
    error = over_known_cells(made)
    monkeypatch.setattr(bars, "fit_smooth_models", lambda *_, **__: NO_SMOOTH_MODELS)
    before = over_known_cells(made)
    assert error < most * before, (error, before)
    assert not made.decodes_the_same()


@pytest.mark.parametrize(
    ("goal", "fields"),
    [("indirect", {"parts": 2}), ("indirect", {"smooth": False}), ("split", {"period": 4})],
)
def test_few_exposures_and_runs_uncorrected_are_told_nothing(
    goal: str, fields: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: Any, **__: Any) -> None:
        raise AssertionError("shares were looked for")

    monkeypatch.setattr("pdcd.pictures.photos._told_of", refused)
    take(tmp_path, goal, **fields)
