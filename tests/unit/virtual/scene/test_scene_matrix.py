"""Scenes from a file, and every way in which a file or the [scene] table can be wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.errors import ConfigError
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.effects import DenseEffect, DirectEffect, Effect, SparseEffect
from pdcd.virtual.scene.matrix import split_into_effects
from tests.places import DATA

TRACED = ["corner_32x24", "mirror_32x24"]


def forms(effects: tuple[Effect, ...]) -> list[type]:
    """Return how each effect is stored."""
    return [type(effect) for effect in effects]


def stored(path: Path, **arrays: Any) -> SceneConfig:
    """Store arrays as an .npz and return the configuration that reads it."""
    with path.open("wb") as stream:
        np.savez(stream, **arrays)
    return SceneConfig(kind="matrix", path=str(path))


@pytest.mark.parametrize("name", TRACED)
def test_traced_scenes_load_as_they_are(name: str) -> None:
    scene = build_scene(SceneConfig(kind="matrix", path=str(DATA / f"{name}.npz")))
    assert scene.name == name
    assert scene.grid == (24, 32)
    with np.load(DATA / f"{name}.npz") as archive:
        transport = archive["transport"].astype(np.float64)
    np.testing.assert_array_equal(scene.dense(), np.broadcast_to(transport, (3, 768, 768)))
    assert scene.white().mean() == pytest.approx(1.0, abs=1e-6)
    direct, indirect = scene.split()
    np.testing.assert_allclose(direct[:, 0], np.diag(transport), rtol=1e-12)
    off = transport - np.diag(np.diag(transport))
    np.testing.assert_allclose(indirect[:, 1], off.sum(axis=1), rtol=1e-12, atol=1e-14)
    assert forms(scene.effects) == [DirectEffect, DenseEffect]


def test_the_rest_of_a_matrix_takes_its_cheaper_form() -> None:
    rng = np.random.default_rng(1)
    full = rng.random((20, 20))
    few = full * (rng.random((20, 20)) < 0.05)
    assert forms(split_into_effects(full)) == [DirectEffect, DenseEffect]
    assert forms(split_into_effects(few)) == [DirectEffect, SparseEffect]
    assert forms(split_into_effects(np.diag(full.diagonal()))) == [DirectEffect]
    for matrix in (full, few):
        np.testing.assert_array_equal(sum(e.dense() for e in split_into_effects(matrix)), matrix)


def test_rows_are_camera_cells_and_columns_projector_cells(tmp_path: Path) -> None:
    transport = np.zeros((6, 6))
    transport[4, 1] = 0.5  # light on cell 1 is seen at cell 4
    scene = build_scene(stored(tmp_path / "s.npz", transport=transport, grid=[2, 3]))
    lit = np.eye(6)[1:2]
    np.testing.assert_array_equal(scene.apply(lit)[0, :, 0], [0, 0, 0, 0, 0.5, 0])
    left, right = np.eye(6)[4:5], np.eye(6)[1:2]
    photo = scene.photo(left, right, np.zeros(6), np.zeros(6))
    np.testing.assert_array_equal(photo[:, 2], [0, 0, 0, 0, 0.5, 0])


@pytest.mark.parametrize("dtype", [np.float32, np.uint8, np.bool_])
def test_any_real_numbers_are_taken(tmp_path: Path, dtype: Any) -> None:
    config = stored(tmp_path / "s.npz", transport=np.ones((2, 2), dtype), grid=np.array([1.0, 2.0]))
    np.testing.assert_array_equal(build_scene(config).white(), 2.0)


def test_ambient_light_is_the_same_everywhere(tmp_path: Path) -> None:
    path = str(tmp_path / "s.npz")
    stored(Path(path), transport=np.eye(2), grid=[1, 2])
    scene = build_scene(SceneConfig(kind="matrix", path=path, ambient=0.25))
    zero = np.zeros((1, 2))
    photo = scene.photo(zero, zero, zero[0], np.array([2.0, 4.0]))
    np.testing.assert_array_equal(photo, [[0.5] * 3, [1.0] * 3])
    assert build_scene(SceneConfig(kind="matrix", path=path)).ambient is None


EYE = np.eye(6)
COLOURED = np.repeat(EYE[..., None], 3, axis=2)
PLAIN = {"transport": EYE, "grid": [2, 3]}
BAD_ARRAYS: list[tuple[dict[str, Any], str]] = [
    ({"grid": [2, 3]}, "no transport"),
    ({"transport": EYE}, "no grid"),
    ({"other": EYE}, "no transport and no grid"),
    ({"transport": EYE[:5], "grid": [2, 3]}, r"shape \(5, 6\).*needs \(6, 6\)"),
    ({"transport": EYE[0], "grid": [2, 3]}, r"shape \(6,\)"),
    ({"transport": EYE, "grid": [3, 3]}, r"needs \(9, 9\)"),
    ({"transport": EYE, "grid": 6}, "two positive whole numbers"),
    ({"transport": EYE, "grid": [1, 2, 3]}, "two positive whole numbers"),
    ({"transport": EYE, "grid": [-2, -3]}, "two positive whole numbers"),
    ({"transport": EYE, "grid": [1.5, 4.0]}, "two positive whole numbers"),
    ({"transport": EYE, "grid": ["2", "3"]}, "`grid`: .* not real numbers"),
    ({"transport": EYE - 0.1, "grid": [2, 3]}, "negative, the first at row 0, column 1"),
    ({"transport": np.where(EYE, np.nan, 0), "grid": [2, 3]}, "6 values that are not finite"),
    ({"transport": EYE * 1e300, "grid": [2, 3]}, r"up to 1e\+300, and 3.40282e\+38 is the most"),
    ({"transport": EYE[..., None], "grid": [2, 3]}, r"shape \(6, 6, 1\)"),
    ({"transport": EYE[:, :4], "grid": [2, 3], "projector_grid": [3, 2]}, r"needs \(6, 6\)"),
    ({"transport": EYE[:, :4], "grid": [2, 3], "projector_grid": [4]}, "`projector_grid` is"),
    ({"transport": -COLOURED, "grid": [2, 3]}, "18 entries that are negative, the first at row 0"),
    (PLAIN | {"texture": np.ones((4, 4))}, r"`texture` has shape \(4, 4\)"),
    (PLAIN | {"texture": np.ones((4, 4, 4))}, r"`texture` has shape \(4, 4, 4\)"),
    (PLAIN | {"texture": np.zeros((2, 2, 3))}, "12 values that are not above 0"),
    (PLAIN | {"texture": np.zeros((0, 2, 3))}, "`texture`: .*holds no number"),
]


@pytest.mark.parametrize(("arrays", "message"), BAD_ARRAYS)
def test_unsound_files_are_refused(tmp_path: Path, arrays: dict[str, Any], message: str) -> None:
    config = stored(tmp_path / "scene.npz", **arrays)
    with pytest.raises(ConfigError, match=message) as caught:
        build_scene(config)
    assert "scene.npz" in caught.value.message
    assert caught.value.hint


def test_a_matrix_scene_needs_a_path_and_nothing_else(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="needs a file"):
        build_scene(SceneConfig(kind="matrix"))
    stored(tmp_path / "s.npz", transport=EYE, grid=[2, 3])
    path = str(tmp_path / "s.npz")
    with pytest.raises(ConfigError, match="'matrix' has none, got seed"):
        build_scene(SceneConfig(kind="matrix", path=path, options={"seed": 1}))
    with pytest.raises(ConfigError, match=r"3 x 2 is asked for.*holds 2 x 3"):
        build_scene(SceneConfig(kind="matrix", path=path, grid=(3, 2)))
    assert build_scene(SceneConfig(kind="matrix", path=path, grid=(2, 3))).grid == (2, 3)


def test_unknown_kinds_are_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="open-boook") as caught:
        build_scene(SceneConfig(kind="open-boook"))
    assert caught.value.hint is not None
    assert {"open-book", "mirror-and-vase", "card", "matrix"} <= {*caught.value.hint.split(", ")}
