"""Preset scenes: sound transport on any grid, and the light that each of them is about."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.errors import ConfigError
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.effects import Array, LowRankEffect, SparseEffect
from pdcd.virtual.scene.kernel import KernelEffect
from pdcd.virtual.scene.presets import PRESETS
from pdcd.virtual.scene.radiosity import Radiosity
from pdcd.virtual.scene.scene import Scene

LARGE = pytest.param((24, 32), marks=pytest.mark.long)
GRIDS = [(1, 1), (1, 9), (7, 1), (2, 2), (13, 17), LARGE]


@cache
def preset(kind: str, grid: tuple[int, int] = (48, 64)) -> Scene:
    return build_scene(SceneConfig(kind=kind, grid=grid))


def images(kind: str) -> tuple[Array, Array]:
    """Direct and indirect images (rows, cols, 3) at the default grid."""
    scene = preset(kind)
    direct, indirect = (part.reshape(*scene.grid, 3) for part in scene.split())
    return direct, indirect


def at(x: float, y: float) -> tuple[int, int]:
    """Cell of the default grid at a place of the drawing frame."""
    return int((y / 2.0 + 0.5) * 48), int((x * 3.0 / 8.0 + 0.5) * 64)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("kind", sorted(PRESETS))
def test_presets_are_passive_and_reversible_on_any_grid(kind: str, grid: tuple[int, int]) -> None:
    whole = preset(kind, grid).dense()
    assert np.isfinite(whole).all()
    assert whole.min() >= 0.0
    assert whole.sum(axis=1).max() <= 1.0
    np.testing.assert_allclose(whole, whole.transpose(0, 2, 1), rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("kind", sorted(PRESETS))
def test_presets_are_passive_at_their_default_grid(kind: str) -> None:
    # Transport is reversible (shown on smaller grids), so its column sums are its row sums.
    scene = preset(kind)
    white = scene.white()
    assert white.max() <= 1.0
    assert 0.2 < white.mean() < 0.7
    direct, indirect = scene.split()
    assert direct.min() >= 0.0
    assert indirect.min() >= -1e-12
    assert indirect.mean() > 0.03
    np.testing.assert_allclose(direct + indirect, white, rtol=1e-12)


def test_the_default_grid_is_48_by_64() -> None:
    assert build_scene(SceneConfig(kind="wax-disk")).grid == (48, 64)


@pytest.mark.parametrize("kind", sorted(PRESETS))
def test_the_seed_makes_the_scene(kind: str) -> None:
    def white(options: dict[str, Any]) -> Array:
        return build_scene(SceneConfig(kind=kind, grid=(12, 16), options=options)).white()

    np.testing.assert_array_equal(white({}), white({"seed": 0}))
    assert not np.array_equal(white({"seed": 0}), white({"seed": 1}))


@pytest.mark.parametrize("kind", sorted(PRESETS))
@pytest.mark.parametrize("options", [{"sed": 1}, {"seed": -1}, {"seed": 1.5}, {"seed": True}])
def test_wrong_options_are_refused(kind: str, options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"\[scene\] options.*sed|\[scene\] options.*seed"):
        build_scene(SceneConfig(kind=kind, options=options))


def test_a_preset_reads_no_file() -> None:
    with pytest.raises(ConfigError, match="reads no file"):
        build_scene(SceneConfig(kind="open-book", path="scene.npz"))


@pytest.mark.parametrize("kind", sorted(PRESETS))
def test_panels_that_stay_black_make_a_black_photo(kind: str) -> None:
    """An exposure of no refreshes at all: a matrix of rank 0."""
    scene = preset(kind, (13, 17))
    nothing, none = np.zeros((0, scene.cells)), np.zeros(scene.cells)
    photo = scene.photo(nothing, nothing, none, none)
    assert photo.shape == (scene.cells, 3) and not photo.any()
    assert scene.apply(nothing).shape == (0, scene.cells, 3)


@pytest.mark.parametrize(
    ("kind", "effects"),
    [
        ("open-book", {Radiosity}),
        ("wax-disk", {KernelEffect}),
        ("disco-ball", {SparseEffect, Radiosity}),
        ("milky-bottle", {KernelEffect, LowRankEffect}),
        ("mirror-and-vase", {SparseEffect, Radiosity}),
    ],
)
def test_presets_hold_only_the_effects_they_need(kind: str, effects: set[type]) -> None:
    assert {type(e) for e in preset(kind).effects if not e.coaxial} == effects


def test_the_picture_colours_the_light_on_the_other_page() -> None:
    _, indirect = images("open-book")
    facing_picture = indirect[at(0.08, -0.25)]
    facing_text = indirect[at(0.08, 0.45)]
    assert facing_picture[2] / facing_picture[0] > 1.02 * facing_text[2] / facing_text[0]


def test_the_pages_light_each_other_most_near_the_spine() -> None:
    _, indirect = images("open-book")
    rows = indirect[14:34].mean(axis=(0, 2))
    assert rows[at(0.10, 0)[1]] > 1.5 * rows[at(1.05, 0)[1]]


def test_the_key_in_the_wax_shows_only_in_indirect_light() -> None:
    direct, indirect = images("wax-disk")
    shaft, beside = at(0.2, 0.0), at(0.2, -0.25)
    assert indirect[shaft].sum() < 0.75 * indirect[beside].sum()
    # The wax is scratched, so compare medians over the key's length and a strip beside it.
    columns = slice(at(-0.1, 0)[1], at(0.28, 0)[1])
    key = np.median(direct[shaft[0], columns], axis=0)
    wax = np.median(direct[beside[0], columns], axis=0)
    np.testing.assert_allclose(key, wax, rtol=0.03)


def test_facets_throw_spots_that_are_far_and_sharp() -> None:
    scene = preset("disco-ball")
    (spots,) = (e for e in scene.effects if isinstance(e, SparseEffect))
    paths = spots.matrix.tocoo()
    rows, cols = (np.stack(np.divmod(side, 64)) for side in paths.coords)
    assert np.median(np.hypot(*(rows - cols))) > 5.0
    # A facet mirrors, it does not scatter: light of one cell reaches few others.
    links = np.bincount(paths.coords[1], minlength=3072)
    assert 0 < np.median(links[links > 0]) < 8
    _, indirect = images("disco-ball")
    assert np.percentile(indirect, 99.5) > 4 * np.median(indirect)


def test_milk_hides_the_letter_that_direct_light_shows() -> None:
    direct, indirect = images("milky-bottle")
    white = direct + indirect
    ink, paper = at(-0.2, 0.4), at(-0.32, 0.3)
    shown = direct[ink].sum() / direct[paper].sum()
    veiled = white[ink].sum() / white[paper].sum()
    assert shown < 0.5 < 0.6 < veiled
    np.testing.assert_array_equal(indirect[at(-1.0, 0.0)], 0.0)


def test_the_mirror_returns_light_to_its_own_cell_and_from_the_vase() -> None:
    direct, indirect = images("mirror-and-vase")
    glass = at(-0.72, 0.0)
    assert direct[glass].min() > 0.05
    assert indirect[glass].min() > 0.05
    scene = preset("mirror-and-vase")
    lit = np.zeros((1, 3072))
    lit[0, glass[0] * 64 + glass[1]] = 1.0
    back = scene.apply(lit)[0].sum(axis=1).reshape(48, 64)
    back[glass] = 0.0
    row, column = np.unravel_index(back.argmax(), back.shape)
    assert abs(row - glass[0]) <= 1
    assert abs(column - at(0.52, 0.0)[1]) <= 2
