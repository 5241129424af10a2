"""Matrix scenes in colour, with detail, and with other cells for the projector than for the camera:
held against dense sums over points so fine that both grids divide them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.errors import ConfigError
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from pdcd.virtual.scene import matrix
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.effects import Array, DenseEffect, DirectEffect, SparseEffect
from pdcd.virtual.scene.matrix import read_transport
from pdcd.virtual.scene.scene import Scene

GRIDS = [
    ((2, 3), (2, 3)),
    ((2, 3), (4, 6)),  # four projector cells in each of the camera's
    ((4, 6), (2, 3)),
    ((4, 3), (2, 6)),  # as many, but others
    ((3, 4), (2, 5)),  # edges of neither are edges of the other
    ((1, 1), (3, 3)),
    ((3, 2), (1, 1)),
]


def built(path: Path, **arrays: Any) -> Scene:
    """Store arrays as an .npz and build the scene."""
    np.savez(path / "s.npz", **arrays)
    return build_scene(SceneConfig(kind="matrix", path=str(path / "s.npz")))


def numbers(grid: tuple[int, int], fine: tuple[int, int]) -> Array:
    """The cell that each point of a fine raster lies in, (rows * cols,)."""
    row = np.arange(fine[0]) * grid[0] // fine[0]
    column = np.arange(fine[1]) * grid[1] // fine[1]
    return np.asarray(row[:, None] * grid[1] + column).ravel()


def dense_photo(
    transport: Array, grid: tuple[int, int], lights: tuple[int, int], mask: Array, light: Array
) -> Array:
    """One code, worked out point by point.

    Direct light, from cells that overlap, comes back where it fell: a point gets what its own
    camera cell was lit with. All other light is that of whole projector cells.
    """
    fine = (grid[0] * lights[0], grid[1] * lights[1])
    camera, projector = numbers(grid, fine), numbers(lights, fine)
    photo = np.zeros((len(mask), 3))
    for n in range(len(mask)):
        for m in range(transport.shape[1]):
            if np.any((camera == n) & (projector == m)):
                arriving = light[n]
            else:
                arriving = light[camera[projector == m]].mean()
            photo[n] += mask[n] * transport[n, m] * arriving
    return photo


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize(("grid", "lights"), GRIDS)
def test_photos_equal_a_dense_sum(
    tmp_path: Path, grid: tuple[int, int], lights: tuple[int, int], colour: bool
) -> None:
    rng = np.random.default_rng(3)
    cells = grid[0] * grid[1]
    shape = (cells, lights[0] * lights[1], *([3] if colour else []))
    transport = rng.random(shape)
    scene = built(tmp_path, transport=transport, grid=grid, projector_grid=lights)
    assert scene.grid == grid

    wide = transport if colour else np.repeat(transport[..., None], 3, axis=2)
    mask, light = rng.random((2, 4, cells))
    wanted = sum(dense_photo(wide, grid, lights, m, p) for m, p in zip(mask, light, strict=True))
    photo = scene.photo(mask, light, np.sum(mask * light, axis=0), np.zeros(cells))
    np.testing.assert_allclose(photo, wanted, rtol=1e-12)
    # Even light, direct light and indirect light: nothing is lost between the grids.
    np.testing.assert_allclose(scene.white(), wide.sum(axis=1), rtol=1e-12)
    fine = (grid[0] * lights[0], grid[1] * lights[1])
    pairs = np.unique(np.stack([numbers(grid, fine), numbers(lights, fine)]), axis=1)
    overlap = np.zeros(wide.shape[:2], dtype=bool)
    overlap[pairs[0], pairs[1]] = True
    direct, indirect = scene.split()
    np.testing.assert_allclose(direct, (wide * overlap[..., None]).sum(axis=1), rtol=1e-12)
    np.testing.assert_allclose(indirect, (wide * ~overlap[..., None]).sum(axis=1), atol=1e-12)


def test_each_colour_takes_the_cheaper_form_of_its_own(tmp_path: Path) -> None:
    transport = np.zeros((20, 20, 3))
    transport[..., 0] = np.random.default_rng(4).random((20, 20))
    transport[3, 7, 1] = 0.5
    scene = built(tmp_path, transport=transport, grid=[4, 5])
    forms: list[tuple[type, str]] = [(type(e), e.name.split()[1]) for e in scene.effects]
    assert forms == [
        (DirectEffect, "red"), (DenseEffect, "red"), (DirectEffect, "green"), (SparseEffect,
        "green"), (DirectEffect, "blue"),
    ]  # fmt: skip
    np.testing.assert_array_equal(scene.dense(), transport.transpose(2, 0, 1))


def test_a_texture_comes_with_the_scene_and_with_ambient_light(tmp_path: Path) -> None:
    texture = np.random.default_rng(5).random((5, 7, 3)) + 0.1
    np.savez(tmp_path / "s.npz", transport=np.eye(6), grid=[2, 3], texture=texture)
    for ambient in (0.0, 0.25):
        config = SceneConfig(kind="matrix", path=str(tmp_path / "s.npz"), ambient=ambient)
        scene = build_scene(config)
        np.testing.assert_array_equal(scene.texture, texture)
        assert (scene.ambient is None) == (ambient == 0.0)


def test_what_is_too_large_is_refused_before_there_is_room_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matrix, "MOST_SCENE_ELEMENTS", 100)
    monkeypatch.setattr(matrix, "MOST_TEXTURE_ELEMENTS", 50)
    eye = np.eye(6)
    built(tmp_path, transport=eye, grid=[2, 3], texture=np.ones((4, 4, 3)))
    with pytest.raises(ConfigError, match=r"`transport`: .*6 x 6 x 3; at most 100"):
        built(tmp_path, transport=np.ones((6, 6, 3)), grid=[2, 3])
    with pytest.raises(ConfigError, match=r"`texture`: .*5 x 4 x 3; at most 50"):
        built(tmp_path, transport=eye, grid=[2, 3], texture=np.ones((5, 4, 3)))
    # 20 camera cells under one lamp are 20 numbers in the file, and 400 here.
    with pytest.raises(ConfigError, match=r"20 camera cells.* 400 numbers; at most 100"):
        built(tmp_path, transport=np.ones((20, 1)), grid=[4, 5], projector_grid=[1, 1])


@pytest.mark.parametrize("arrays", [
    {"transport": np.ones((6, 6, 3)), "grid": [2, 3]},
    {"transport": np.ones((6, 6)), "grid": [2, 3], "projector_grid": [3, 2]},
])  # fmt: skip
def test_a_prior_is_one_matrix_over_one_grid(tmp_path: Path, arrays: dict[str, Any]) -> None:
    np.savez(tmp_path / "p.npz", **arrays)
    with pytest.raises(UnsoundFileError, match="two grids or in colour"):
        read_transport((tmp_path / "p.npz").read_bytes(), ArrayLimits(1000))
    np.savez(tmp_path / "p.npz", transport=np.eye(6), grid=[2, 3], texture=np.zeros(1))
    transport, grid = read_transport((tmp_path / "p.npz").read_bytes(), ArrayLimits(1000))
    np.testing.assert_array_equal(transport, np.eye(6))
    assert grid == (2, 3)
