"""The correction for smooth light, through the whole chain."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pdcd.bench.tables import CameraConfig, Config, SceneConfig
from tests import bench_rig
from tests.taken import take

pytestmark = pytest.mark.whole

WAYS: dict[str, dict[str, Any]] = {
    "default": {},
    "on": {"smooth": True},
    "off": {"smooth": False},
    "balanced": {"family": "balanced"},
    "balanced on": {"family": "balanced", "smooth": True},
    "row": {"normalise": "row"},
    "row off": {"normalise": "row", "smooth": False},
}


def bench(folder: Path, kind: str = "milky-bottle") -> Config:
    scene = SceneConfig(kind=kind, grid=(24, 32))
    return bench_rig.config(folder, scene=scene, camera=CameraConfig(noise="none"))


def test_milk_gets_closer_to_the_truth_with_hadamard_codes_and_with_others_where_it_is_asked_for(
    tmp_path: Path,
) -> None:
    """Codes that were lost and weights of each cell are known to it."""
    errors = {}
    for name, fields in WAYS.items():
        made = take(bench(tmp_path), codes=32, out=str(tmp_path / name), **fields)
        errors[name] = made.error
        if name in ("on", "off"):
            assert made.decodes_the_same()
    assert errors["default"] == errors["on"] < 0.8 * errors["off"]
    assert errors["balanced on"] < 0.7 * errors["balanced"]
    assert errors["row"] < 0.9 * errors["row off"]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["milky-bottle", "open-book"])
def test_what_quarter_windows_miss_beside_each_cell_is_not_taken_for_an_error_of_codes(
    tmp_path: Path, kind: str
) -> None:
    with_, without = (
        take(
            bench(tmp_path, kind),
            codes=128,
            window="quarter",
            smooth=smooth,
            out=f"{tmp_path}/{smooth}",
        )
        for smooth in (True, False)
    )
    assert with_.error < 1.01 * without.error
