"""True answers: of recipes of every kind, single entries, what is kept of them, and comparisons."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config
from pdcd.errors import Cancelled, DecodeError
from pdcd.panels.map import Map
from pdcd.pictures import truth as module
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.truth import (
    TRUTH,
    KnownAnswer,
    apply_probing_matrix,
    compute_true_answer,
    compute_true_entries,
    find_known_answer,
    read_known_answer,
    write_known_answer,
)
from pdcd.planning.make import make_plan
from pdcd.probing.wanted import (
    FullPart,
    MatchPart,
    MatrixPart,
    NearPart,
    OuterPart,
    UniformPart,
    WantedMatrix,
    shift_cells,
)
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.presets import PRESETS
from pdcd.virtual.scene.scene import Scene
from tests.unit.planning.test_measured import config

GRID = (3, 4)
CELLS = 12
RNG = np.random.default_rng(4)
TRANSPORT = RNG.random((CELLS, CELLS, 3)) + np.eye(CELLS)[..., None]
SCENE = Scene("coloured", GRID, split_into_effects(TRANSPORT))
DIRECT = np.einsum("nnc->nc", TRANSPORT)
WHOLE = TRANSPORT.sum(axis=1)
MAP = CellMap(grid=GRID, frame=GRID, map=Map.filling((4, 3)))


PRESET_GRID = (6, 8)
N = PRESET_GRID[0] * PRESET_GRID[1]
LIGHT = np.where(RNG.random(N) < 0.3, 0.0, RNG.random(N))
ALL, SAME = (1.0, UniformPart(N)), (-1.0, MatchPart(np.arange(N)))
REGION = (0.5, OuterPart(RNG.random(N), RNG.random(N)))


@pytest.mark.parametrize("light", [None, LIGHT])
@pytest.mark.parametrize(
    "parts",
    [
        (ALL,),
        (ALL, SAME),
        (ALL, REGION),
        (ALL, REGION, SAME),
        (ALL, (-1.0, NearPart(PRESET_GRID, 1))),
        (SAME, (1.0, MatchPart(shift_cells(PRESET_GRID, (1, -1))))),
        ((1.0, FullPart(RNG.normal(size=(N, N)))), ALL),
    ],
)
@pytest.mark.parametrize("kind", ["mirror-and-vase", "milky-bottle"])
def test_a_true_picture_is_the_sum_over_all_paths(
    kind: str, parts: tuple[tuple[float, MatrixPart], ...], light: np.ndarray | None
) -> None:
    scene = PRESETS[kind](PRESET_GRID, {})
    wanted = WantedMatrix(PRESET_GRID, parts, light)
    whole = np.einsum("nm,cnm->nc", wanted.dense(), scene.dense())
    np.testing.assert_allclose(apply_probing_matrix(scene, wanted), whole, rtol=1e-12, atol=1e-12)


def recipe_of(**fields: Any) -> Recipe:
    whole = {"codes": 8, "window": "whole", **fields}
    return make_plan(msgspec.convert(whole, CaptureRequest), Config(), GRID).recipe


@pytest.mark.parametrize(
    ("fields", "wanted"),
    [
        ({"goal": "white"}, WHOLE),
        ({"goal": "direct"}, DIRECT),
        ({"goal": "indirect"}, WHOLE - DIRECT),
        ({"goal": "fraction", "p": 0.25}, DIRECT + 0.25 * (WHOLE - DIRECT)),
        ({"goal": "diagonal"}, DIRECT),
    ],
)
def test_an_answer_is_the_wanted_share_of_all_paths(
    fields: dict[str, Any], wanted: np.ndarray
) -> None:
    recipe = recipe_of(**fields)
    found = compute_true_answer(SCENE, recipe)
    assert found.shape == (CELLS, 3)
    np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10)


def test_an_answer_of_extremes_is_that_of_its_photos() -> None:
    recipe = recipe_of(goal="direct", method="nayar")
    np.testing.assert_allclose(compute_true_answer(SCENE, recipe), DIRECT, atol=1e-10)
    rule: Any = recipe.answer
    photos = {photo.name: photo.wanted for photo in recipe.photos}
    bare = replace(recipe, meant=None)
    images = np.stack([apply_probing_matrix(SCENE, photos[name]) for name in rule.photos])
    wanted = rule.largest * images.max(axis=0) + rule.smallest * images.min(axis=0)
    np.testing.assert_allclose(compute_true_answer(SCENE, bare), wanted)
    assert (rule.largest, rule.smallest) == (1.0, -1.0)


def test_entries_are_those_of_the_transport(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, lit = np.array([3, 0, 7]), np.array([11, 2, 5, 5, 0])
    for block in (256, 2, 5):
        monkeypatch.setattr(module, "TRUTH_BLOCK_ROWS", block)
        found = compute_true_entries(SCENE, seen, lit)
        np.testing.assert_allclose(found, TRANSPORT[seen][:, lit])


def ended() -> None:
    raise Cancelled("nobody waits")


def test_rows_are_taken_in_blocks_and_the_work_may_be_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recipe = recipe_of(goal="short-range", radius=1)
    row, column = np.divmod(np.arange(CELLS), 4)
    far = np.maximum(abs(row[:, None] - row), abs(column[:, None] - column)) > 1
    near = np.einsum("nm,nmc->nc", ~far, TRANSPORT) - DIRECT
    for block in (5, 4, 12):
        monkeypatch.setattr(module, "TRUTH_BLOCK_ROWS", block)
        np.testing.assert_allclose(compute_true_answer(SCENE, recipe), near)
    with pytest.raises(Cancelled):
        find_known_answer(Config(), SCENE, recipe, ("whole",), MAP, ended)


def test_the_truth_of_a_bench_of_cells_is_told_by_cells() -> None:
    recipe = recipe_of(goal="indirect")
    found = find_known_answer(Config(), SCENE, recipe, ("whole",), MAP)
    assert found is not None and found.of_cells and found.seen.all()
    np.testing.assert_allclose(found.image, WHOLE - DIRECT)
    assert find_known_answer(Config(), None, recipe, ("whole",), MAP) is None
    assert find_known_answer(Config(), SCENE, recipe, ("whole",), None) is None


def test_the_truth_of_a_bench_of_pixels_is_seen_through_its_optics() -> None:
    rig = config(camera={"frame_quads": (16, 12)}, schedule={"grid": GRID})
    cells = CellMap(grid=GRID, frame=(12, 16), map=Map.filling((16, 12)))
    found = find_known_answer(rig, SCENE, recipe_of(goal="white"), ("whole",), cells)
    assert found is not None and not found.of_cells
    assert found.image.shape == (12, 16, 3) and found.seen.shape == (12, 16)
    means = found.on_cells(cells).reshape(CELLS, 3)
    known = np.isfinite(means).all(axis=1)
    np.testing.assert_allclose(means[known], WHOLE[known], rtol=1e-6)
    assert known.any()
    other = CellMap(grid=GRID, frame=(24, 32), map=Map.filling((32, 24)))
    assert find_known_answer(rig, SCENE, recipe_of(goal="white"), ("whole",), other) is None
    # Extremes over photos are not linear in what is seen.
    extremes = recipe_of(goal="direct", method="nayar")
    assert find_known_answer(rig, SCENE, extremes, ("whole",), cells) is None
    # What is meant is a matter of the cells of the codes, whatever cells a scene has.
    finer = Scene("finer", (6, 8), split_into_effects(np.eye(48) + 0.01))
    indirect = find_known_answer(rig, finer, recipe_of(goal="indirect"), ("whole",), cells)
    assert indirect is not None
    near = find_known_answer(rig, finer, recipe_of(goal="short-range", radius=1), (), cells)
    assert near is not None
    # Each lights four of the scene's 48, and a neighbour gets 0.01 of each.
    light = indirect.on_cells(cells)[..., 0]
    np.testing.assert_allclose(light[np.isfinite(light)], 44 * 0.01, rtol=1e-6)
    neighbours = [[3, 5, 5, 3], [5, 8, 8, 5], [3, 5, 5, 3]]
    np.testing.assert_allclose(near.on_cells(cells)[..., 0], 0.04 * np.array(neighbours))


FEW = CellMap(grid=(2, 3), frame=(4, 6), map=Map.filling((6, 4)))


def picture(image: Any, sigma: Any = 0.0) -> PictureWithErrors:
    error = np.broadcast_to(np.asarray(sigma, np.float64), image.shape)
    return PictureWithErrors(image, error, error, error, "sensor")


@pytest.mark.parametrize("of_cells", [True, False])
def test_a_truth_is_compared_where_it_is_seen(of_cells: bool) -> None:
    shape = (6,) if of_cells else (4, 6)
    truth, seen = RNG.random((*shape, 3)), np.ones(shape, np.bool_)
    seen[-1] = False
    known = KnownAnswer(truth, seen, of_cells=of_cells)
    found = truth * 1.1
    found[~seen] = 99.0
    quads = np.zeros((4, 6, 3)) if of_cells else found
    means = found.reshape(2, 3, 3) if of_cells else np.zeros((2, 3, 3))
    errors = known.rms_errors(picture(quads), picture(means), FEW)
    assert errors[of_cells] == pytest.approx(0.1)
    dark = KnownAnswer(0.0 * truth, seen, of_cells=of_cells)
    assert dark.rms_errors(picture(quads), picture(means), FEW) == (None, None)
    on_quads, there = known.on_quads(FEW)
    assert on_quads.shape == (4, 6, 3) and there.shape == (4, 6)
    on_cells = known.on_cells(FEW)
    assert np.isfinite(on_cells[0]).all() and np.isnan(on_cells).any()


def test_quads_without_an_error_bar_are_not_compared() -> None:
    truth = RNG.random((4, 6, 3))
    known = KnownAnswer(truth, np.ones((4, 6), np.bool_), of_cells=False)
    image, sigma = truth * 1.2, np.zeros((4, 6, 3))
    image[1, 2], sigma[1, 2, 0] = 99.0, np.inf
    means = picture(0.9 * truth.reshape(2, 2, 3, 2, 3).mean(axis=(1, 3)))
    assert known.rms_errors(picture(image, sigma), means, FEW) == pytest.approx((0.2, 0.1))


def test_squares_of_quads_are_known_where_all_of_them_are() -> None:
    image, seen = np.arange(4 * 6 * 3.0).reshape(4, 6, 3), np.ones((4, 6), np.bool_)
    seen[1, 2] = False
    known = KnownAnswer(image, seen, of_cells=False)
    found = known.binned(2)
    assert found.seen.tolist() == [[True, False, True], [True, True, True]]
    assert not found.of_cells and found.image.shape == (2, 3, 3)
    assert found.image[0, 0] == pytest.approx(image[:2, :2].mean(axis=(0, 1)))
    assert known.binned(1) is known
    cells = KnownAnswer(image.reshape(-1, 3), seen.ravel(), of_cells=True)
    assert cells.binned(2) is cells


GOOD: dict[str, np.ndarray] = {
    "image": WHOLE.astype(np.float32), "seen": np.ones(CELLS, np.bool_), "of_cells": np.array(True),
}  # fmt: skip


@pytest.mark.parametrize(
    "wrong",
    [
        {"image": None}, {"seen": None}, {"of_cells": None}, {"image": WHOLE},
        {"seen": np.ones(CELLS)}, {"image": GOOD["image"][1:]}, {"seen": GOOD["seen"][1:]},
    ],
)  # fmt: skip
def test_a_truth_is_kept_and_one_that_does_not_fit_is_refused(
    tmp_path: Path, wrong: dict[str, Any]
) -> None:
    """Lacking an array, of another type, or of other cells."""
    write_known_answer(tmp_path, KnownAnswer(WHOLE, GOOD["seen"], of_cells=True))
    back = read_known_answer(tmp_path, MAP)
    assert np.array_equal(back.image, GOOD["image"]) and back.seen.all() and back.of_cells
    kept = {name: array for name, array in {**GOOD, **wrong}.items() if array is not None}
    np.savez(tmp_path / TRUTH, **kept)
    with pytest.raises(DecodeError, match="does not fit the run"):
        read_known_answer(tmp_path, MAP)
