"""A glint that is full of light, in a cell whose other quads are not: nobody knows their mean."""

from pathlib import Path

import numpy as np
import pytest

import pdcd
from pdcd.arrays import Floats

GRID, SIDE = (12, 16), 4
N = GRID[0] * GRID[1]
BRIGHT = 40.0


def make_texture() -> Floats:
    """Of the first three cells of two rows one quad is much brighter."""
    texture = np.ones((GRID[0] * SIDE, GRID[1] * SIDE))
    texture[1 : 2 * SIDE : SIDE, 1 : 3 * SIDE : SIDE] = BRIGHT
    return texture


@pytest.mark.parametrize(("f_number", "known"), [(5.6, False), (11.0, True)])
def test_the_mean_of_a_cell_with_a_full_quad_is_unknown(
    f_number: float, known: bool, tmp_path: Path
) -> None:
    path, texture = tmp_path / "scene.npz", make_texture()[..., None].repeat(3, axis=2)
    np.savez(path, transport=0.3 * np.eye(N) + 0.3 / N, grid=GRID, texture=texture)
    scene = {"kind": "matrix", "path": str(path)}
    config = {"scene": scene, "camera": {"quads_per_cell": SIDE, "f_number": f_number}}
    with pdcd.local(config, folder=tmp_path) as bench:
        run = bench.capture("indirect", codes=128, progress=False)
    glints = np.zeros(GRID, np.bool_)
    glints[:2, :3] = True
    assert np.array_equal(np.isfinite(run.sigma).all(axis=-1), ~glints | known)
    assert run.truth is not None
    off = np.abs(run.image - run.truth) / run.sigma
    assert np.mean(off <= 1.96) > 0.9 and off.max() < 6.0
    again = run.decode(progress=False)
    assert np.array_equal(again.sigma, run.sigma) and np.array_equal(again.image, run.image)
    error = run.summary["rms_error_cells"]
    assert isinstance(error, float) and error < 0.005
