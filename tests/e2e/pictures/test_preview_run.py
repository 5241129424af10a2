"""Previews of a run: a white patch is asked for, kept, used, and missed where it is dark."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pdcd.bench.tables import Config, SceneConfig
from pdcd.pictures.decode import decode_folder
from pdcd.runs.record import Manifest
from tests import bench_rig
from tests.captions import caption_height
from tests.taken import take


def taken(config: Config, place: tuple[float, float]) -> tuple[Path, Manifest]:
    made = take(config, goal="white", white_patch=place)
    assert made.manifest.run.white_patch == place
    assert made.manifest.request["white_patch"] == list(place)
    return made.folder, made.manifest


def warned(manifest: Manifest) -> list[str]:
    return [text for text in manifest.warnings if "white patch" in text]


def test_amber_wax_that_is_said_to_be_white_is_grey(tmp_path: Path) -> None:
    config = bench_rig.config(tmp_path, scene=SceneConfig(kind="wax-disk", grid=(12, 16)))
    folder, manifest = taken(config, (0.5, 0.5))
    seen = cv2.imread(str(folder / "preview" / "white.png"))
    assert seen is not None and seen.shape == (480 + caption_height(640), 640, 3)
    assert np.ptp(seen[240, 320].astype(int)) <= 2 and seen[240, 320, 1] > 150
    assert not warned(manifest)
    assert decode_folder(folder).identical


def test_a_patch_in_the_dark_is_told_at_the_end(tmp_path: Path) -> None:
    transport = np.diag(np.linspace(0.3, 0.5, 12))
    transport[6, 6] = 0.0  # of 3 x 4 cells, that at row 1, column 2
    path = tmp_path / "dark.npz"
    np.savez(path, transport=transport, grid=np.array(bench_rig.GRID))
    config = bench_rig.config(tmp_path, scene=SceneConfig(kind="matrix", path=str(path)))
    _, manifest = taken(config, (2.5 / 4, 1.5 / 3))
    assert warned(manifest) == ["nothing can be seen of a white patch at 0.625 0.5"]
