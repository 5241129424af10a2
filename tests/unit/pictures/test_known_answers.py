"""Answers in truth: of recipes of every kind, where they can be compared, and single entries."""

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
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap
from pdcd.virtual.scene.matrix import split_into_effects
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
    if recipe.meant is not None:
        np.testing.assert_allclose(
            compute_true_answer(SCENE, recipe), apply_probing_matrix(SCENE, recipe.meant)
        )
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


def test_rows_are_taken_in_blocks_and_each_is_a_sign_of_life(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recipe = recipe_of(goal="short-range", radius=1)
    whole = compute_true_answer(SCENE, recipe)
    for block, signs in ((5, 3), (4, 3), (12, 1)):
        monkeypatch.setattr(module, "TRUTH_BLOCK_ROWS", block)
        heard: list[int] = []
        found = compute_true_answer(SCENE, recipe, lambda heard=heard: heard.append(1))  # type: ignore[misc]
        np.testing.assert_allclose(found, whole)
        assert len(heard) == signs
    row, column = np.divmod(np.arange(CELLS), 4)
    far = np.maximum(abs(row[:, None] - row), abs(column[:, None] - column)) > 1
    near = np.einsum("nm,nmc->nc", ~far, TRANSPORT) - DIRECT
    np.testing.assert_allclose(whole, near)  # of the cells around each, without its own light

    def ended() -> None:
        raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        compute_true_answer(SCENE, recipe, ended)


def test_the_truth_of_a_bench_of_cells_is_told_by_cells() -> None:
    recipe = recipe_of(goal="indirect")
    found = find_known_answer(Config(), SCENE, recipe, ("whole",), MAP)
    assert found is not None and found.of_cells and found.seen.all()
    np.testing.assert_allclose(found.image, WHOLE - DIRECT)
    assert find_known_answer(Config(), None, recipe, ("whole",), MAP) is None
    assert find_known_answer(Config(), SCENE, recipe, ("whole",), None) is None

    def ended() -> None:
        raise Cancelled("nobody waits")

    with pytest.raises(Cancelled):
        find_known_answer(
            Config(), SCENE, recipe_of(goal="short-range", radius=1), ("whole",), MAP, ended
        )


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


def picture(image: np.ndarray, sigma: np.ndarray) -> PictureWithErrors:
    return PictureWithErrors(image, sigma, sigma, sigma, "sensor")


def test_quads_without_an_error_bar_are_not_compared() -> None:
    truth = RNG.random((4, 6, 3))
    known = KnownAnswer(truth, np.ones((4, 6), np.bool_), of_cells=False)
    sigma = np.zeros((4, 6, 3))
    image = truth * 1.2
    image[1, 2] = 99.0
    sigma[1, 2, 0] = np.inf
    cells = CellMap(grid=(2, 3), frame=(4, 6), map=Map.filling((6, 4)))
    by_cell = truth.reshape(2, 2, 3, 2, 3).mean(axis=(1, 3))
    means = picture(0.9 * by_cell, np.zeros((2, 3, 3)))
    wanted = pytest.approx((0.2, 0.1))
    assert known.rms_errors(picture(image, sigma), means, cells) == wanted
    sigma[1, 2, 0] = 0.0
    found, _ = known.rms_errors(picture(image, sigma), means, cells)
    assert found == pytest.approx(np.sqrt(np.sum((image - truth) ** 2) / np.sum(truth**2)))


@pytest.mark.parametrize("missing", ["image", "seen", "of_cells"])
def test_a_truth_that_lacks_something_does_not_fit(tmp_path: Path, missing: str) -> None:
    known = KnownAnswer(WHOLE, np.ones(CELLS, np.bool_), of_cells=True)
    write_known_answer(tmp_path, known)
    assert read_known_answer(tmp_path, MAP).of_cells
    with np.load(tmp_path / TRUTH) as kept:
        arrays = {name: kept[name] for name in kept.files if name != missing}
    np.savez(tmp_path / TRUTH, **arrays)
    with pytest.raises(DecodeError, match="does not fit the run") as caught:
        read_known_answer(tmp_path, MAP)
    assert "copy" in str(caught.value.hint)
    wrong = {"image": WHOLE.astype(np.float64), "seen": np.ones(CELLS), "of_cells": np.array(True)}
    for name in ("image", "seen"):
        good = {
            "image": WHOLE.astype(np.float32), "seen": np.ones(CELLS, np.bool_),
            "of_cells": np.array(True),
        }  # fmt: skip
        np.savez(tmp_path / TRUTH, **{**good, name: wrong[name]})
        with pytest.raises(DecodeError):
            read_known_answer(tmp_path, MAP)
