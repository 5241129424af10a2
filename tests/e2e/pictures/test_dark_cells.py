"""Cells without light in the white photo: a black thing, and lines that a mask does not show."""

from pathlib import Path

import numpy as np
import pytest

import pdcd

pytestmark = pytest.mark.whole

GRID = (12, 16)
N = GRID[0] * GRID[1]
PANEL = {"size_px": [128, 96]}
"""Eight pixels a cell along a side."""


def test_a_black_thing_is_a_remark(tmp_path: Path) -> None:
    """Of six cells no light comes back, whatever arrives there."""
    black = np.zeros(GRID, np.bool_)
    black[4:6, 5:8] = True
    transport = (0.3 * np.eye(N) + 0.3 / N) * ~black.reshape(-1, 1)
    np.savez(tmp_path / "scene.npz", transport=transport, grid=GRID)
    scene = {"kind": "matrix", "path": str(tmp_path / "scene.npz")}
    config = {"scene": scene, "camera": {"quads_per_cell": 4}}
    with pdcd.local(config, folder=tmp_path) as bench:
        run = bench.capture("indirect", codes=128, progress=False)
    assert run.verdict == "good"
    assert [text for text in run.quality.remarks if "6 of 192 cells have no light" in text]


@pytest.mark.parametrize(("dead", "verdict"), [((32, 64), "doubtful"), ((1, 3), "good")])
def test_lines_of_a_mask_that_stay_dark_are_a_reason(
    dead: tuple[int, int], verdict: str, tmp_path: Path
) -> None:
    """Four whole rows of cells in the middle of the field, or two pixels of one."""
    (tmp_path / "truth.toml").write_text(f"[mask]\ndead_rows = {list(range(*dead))}\n")
    config = {
        "scene": {"kind": "open-book", "grid": list(GRID)},
        "projector": PANEL,
        "mask": PANEL,
        "camera": {"frame_quads": [80, 60]},
        "bench": {"truth": str(tmp_path / "truth.toml")},
    }
    with pdcd.local(config, folder=tmp_path) as bench:
        run = bench.capture("indirect", codes=128, progress=False)
    assert run.verdict == verdict, run.quality
    told = [text for text in run.quality.reasons if "4 whole rows between lit ones" in text]
    assert bool(told) == (verdict == "doubtful")
    assert all("64 of 192 cells have no light" in text for text in told)
