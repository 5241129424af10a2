"""`calibrate disparity`: which projector cell lights each camera cell of an off-axis bench."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.config import load_config
from pdcd.bench.reading import format_toml
from pdcd.bench.tables import Config, RigConfig, SceneConfig
from pdcd.cli.main import main
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.displaced import DisplacedEffect
from tests.e2e.calibration.steps_rig import SmallBench

pytestmark = pytest.mark.whole

GRID = (24, 32)


def off_axis(folder: Path, kind: str) -> SmallBench:
    tables = {
        "rig": RigConfig(arrangement="off-axis"),
        "scene": SceneConfig(kind=kind, grid=GRID),
    }
    return SmallBench(folder, placed=True, quads=(512, 384), tables=tables)


def true_disparity(config: Config) -> NDArray[np.float64]:
    """Cells to the right, by the geometry of the scene; NaN in shadow."""
    (direct,) = {
        effect.displacement.tobytes(): effect.displacement
        for effect in build_scene(config.scene).effects
        if isinstance(effect, DisplacedEffect)
    }.values()
    return np.asarray(direct[:, 1].reshape(GRID))


@pytest.mark.parametrize(
    "kind",
    [
        "off-axis-wedge",
        *(pytest.param(f"off-axis-{k}", marks=pytest.mark.long) for k in ("shelf", "box")),
    ],
)
def test_depth_is_seen_as_geometry_demands(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = off_axis(tmp_path, kind)
    found = bench.calibrate("disparity", subject="scene")
    file = found.folder / "disparities.npy"
    said, true = np.load(file), true_disparity(bench.config)
    known = said < GRID[1]
    assert (known == np.isfinite(true)).mean() > 0.95
    both = known & np.isfinite(true)
    off = np.abs(said - true)[both]
    assert np.median(off) < 0.03 and np.percentile(off, 90.0) < 0.1
    assert found.value("disparity.off_rows") < 0.1
    assert found.record.verdict == "good"
    # A request takes the file as it is.
    plain = {"rig": {"arrangement": "off-axis"}, "scene": {"kind": kind, "grid": list(GRID)}}
    path = tmp_path / "plan.toml"
    path.write_text(format_toml(plain))
    assert load_config(path).scene.grid == GRID
    words = ["plan", "keyed", "--config", str(path), "--disparities", str(file), "--local"]
    assert main(words) == 0, capsys.readouterr().err


def test_a_card_has_no_disparities(tmp_path: Path) -> None:
    found = off_axis(tmp_path, "off-axis-box").calibrate("disparity")
    assert found.result.error is not None
    assert "--scene" in str(found.result.error["hint"])
