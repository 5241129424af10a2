"""A mock camera that sees parts of cells: photos of quarter windows are those of a bench of pixels.

The reference is the same rig, said to be placed where it lies anyway, which is a bench of pixels.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig, Config, RigConfig
from pdcd.panels.placing import Placing
from tests import bench_rig, taken

Floats = NDArray[np.floating]

GRID = (6, 8)
REQUEST: dict[str, Any] = {
    "goal": "indirect",
    "codes": 16,
    "family": "bernoulli",
    "black_level": "none",
}
"""Without dark photos: one before the run, which only a bench of pixels has, would move what jitter
is drawn next. For the same reason nobody looks at the panels."""


def config_of(
    folder: Path, per_cell: int, offset_px: tuple[float, float], *, of_pixels: bool
) -> Config:
    """Slow, leaking, jittery panels that miss refreshes, before a scene without detail in cells."""
    folder.mkdir()
    replace = msgspec.structs.replace
    panels = {
        "projector": replace(bench_rig.DEFECTS["projector"], size_px=(128, 96)),
        "mask": replace(bench_rig.DEFECTS["mask"], size_px=(160, 120), offset_px=offset_px),
    }
    rows, cols = (side * per_cell for side in GRID)
    filled = (1.0 / cols, 0.0, 0.0, 0.0, 1.0 / rows, 0.0, 0.0, 0.0, 1.0)
    place = Placing(homography=filled) if of_pixels else Placing()
    camera = CameraConfig(noise="none", f_number=8.0, quads_per_cell=per_cell, place=place)
    rig = RigConfig(on_miss="flag", look_at_panels=False)
    return bench_rig.with_defects(folder, grid=GRID, camera=camera, rig=rig, **panels)


def take(config: Config, **asked: Any) -> tuple[dict[str, Floats], float]:
    """Pictures of a capture by name, and the error that it reports."""
    made = taken.take(config, **{**REQUEST, **asked})
    assert any(shot.missed for shot in made.manifest.run.shots)  # what is to be tested
    names = [file.stem for file in (made.folder / "linear").glob("*.tif")]
    return {name: made.picture(name) for name in names}, made.error


@pytest.mark.parametrize(
    ("per_cell", "window", "offset_px"),
    [(4, "quarter", (0.0, 0.0)), (10, "quarter", (0.0, 0.0)), (4, "whole", (5.0, -3.0))],
)
def test_windows_that_fall_on_parts_of_cells_are_seen_so(
    tmp_path: Path, per_cell: int, window: str, offset_px: tuple[float, float]
) -> None:
    (found, told), (wanted, right) = (
        take(config_of(tmp_path / name, per_cell, offset_px, of_pixels=name == "pixels"),
             window=window)
        for name in ("cells", "pixels")
    )  # fmt: skip
    assert found.keys() == wanted.keys() and "indirect" in found
    for name, picture in wanted.items():
        assert np.abs(found[name] - picture).max() <= 1e-6 * wanted["white"].max(), name
    assert told == pytest.approx(right, rel=1e-4)


def test_cells_are_enough_for_one_quad_a_cell_and_for_windows_as_large(tmp_path: Path) -> None:
    """The bench of pixels, which takes longer, is not even made."""
    for per_cell, window in ((1, "quarter"), (4, "whole")):
        folder = tmp_path / window
        config = config_of(folder, per_cell, (0.0, 0.0), of_pixels=False)
        made = taken.take(config, **{**REQUEST, "window": window})
        bench = bench_rig.bench_of(made.engine)
        assert bench.optics is None and "_optics_of_pixels" not in vars(bench)
