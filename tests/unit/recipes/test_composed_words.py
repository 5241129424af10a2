"""How a plain matrix is taken apart, in words, and the sum of photos that it is then."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.probing.wanted import NearPart
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.programs import CodedProgram
from pdcd.recipes.recipe import Recipe
from pdcd.recipes.structure import find_structure

GRID = (9, 12)
N = 108
Floats = NDArray[np.float64]
RNG = np.random.default_rng(21)
WARP, WARP_B = RNG.permutation(N), RNG.permutation(N)


def by_warp(partner: NDArray[np.int64]) -> Floats:
    out = np.zeros((N, N))
    there = np.flatnonzero(partner >= 0)
    out[there, partner[there]] = 1.0
    return out


def recipe(matrix: Floats, codes: int = 128) -> Recipe:
    target = Target(Goal(name="relit"), GRID, matrices={"matrix": matrix})
    return make_recipe(target, CaptureScheme(codes=codes))


def terms(found: Recipe) -> dict[str, Any]:
    assert found.pictures.keys() == {"relit"}
    rule = found.pictures["relit"]
    assert isinstance(rule, tuple)
    return {name: pytest.approx(weight) for weight, name in rule}


@pytest.mark.parametrize("level", [1.0, 2.5])
def test_all_but_the_cell_itself_is_one_photo(level: float) -> None:
    found = recipe(level * (1.0 - np.eye(N)))
    assert found.split == (
        "100 % all but the cell itself: codes with their complements, one exposure",
    )
    assert terms(found) == {"coded": level}


def test_a_part_of_the_matched_cell_is_kept_by_white_light() -> None:
    found = recipe(2.0 * (1.0 - 0.7 * by_warp(WARP)))
    assert found.split == (
        "100 % all but one cell each: codes with their complements, one exposure, "
        "and 30 % of white",
    )
    assert terms(found) == {"kept": 0.6, "coded": 1.4}
    assert found.main == "coded"


@pytest.mark.parametrize(
    ("kept", "p", "weights"),
    [
        (3.0, 0.25, {"coded": 8.0 / 3.0, "kept": 1.0 / 3.0}),  # 2/3 of (1 - p) / p = 3
        (4.0, 0.25, {"coded": 4.0}),
        (2.0, 0.5, {"coded": 2.0}),
        (1.5, 0.5, {"coded": 1.0, "kept": 0.5}),
    ],
)
def test_more_of_the_matched_cell_takes_codes_that_are_lit_less_often(
    kept: float, p: float, weights: dict[str, float]
) -> None:
    found = recipe(1.0 + (kept - 1.0) * np.eye(N))
    (line,) = found.split
    white = ", and white" * ("kept" in weights)
    assert line == (
        f"100 % the cell itself and {100.0 / kept:.3g} % of the rest: codes lit with p = {p}, "
        f"one exposure{white}"
    )
    assert terms(found) == weights
    program = found.programs["coded"]
    assert isinstance(program, CodedProgram) and (program.p, program.complement) == (p, False)
    (photo,) = (photo for photo in found.photos if photo.name == "coded")
    assert photo.wanted.by_direct


def test_bands_are_what_far_light_leaves() -> None:
    near = NearPart(GRID, 2).rows(0, N)
    found = recipe(1.0 - near)
    assert terms(found) == {"far-2": 1.0}
    assert found.split == (
        "100 % beyond 2 cells: codes that are dark around what is lit, one exposure",
    )
    found = recipe(1.0 + 0.5 * near)
    assert terms(found) == {"white": 1.5, "far-2": -0.5}
    assert [line.partition("% ")[2] for line in found.split] == [
        "all light alike: 1 exact pair, one exposure",
        "within 2 cells: codes that are dark around what is lit, one exposure",
    ]
    shares = [float(line.partition(" %")[0]) for line in found.split]
    squares = np.array([N**2, 0.25 * near.sum()])
    assert shares == pytest.approx(100.0 * squares / squares.sum(), rel=6e-3)


def test_matches_alone_are_taken_by_signed_codes() -> None:
    found = recipe(0.75 * by_warp(WARP) - 0.5 * by_warp(np.where(WARP == WARP_B, -1, WARP_B)))
    assert terms(found) == {"matched": 1.0}
    assert {line.partition("% ")[2] for line in found.split} == {
        "0.75 times one cell each: signed codes, two exposures",
        "-0.5 times one cell each: signed codes, two exposures",
    }
    assert [shot.name for shot in found.shots] == ["matched-plus", "matched-minus"]


def test_more_than_four_matches_are_told_together() -> None:
    own = np.arange(N).reshape(GRID)
    matrix = np.zeros((N, N))
    for step in range(1, 6):
        matrix += step * by_warp(np.roll(own, step, axis=1).ravel())
    (line,) = recipe(matrix).split
    assert line == "100 % 5 matched cells each: signed codes, two exposures"
    matrix -= 5.0 * by_warp(np.roll(own, 5, axis=1).ravel())
    assert len(recipe(matrix).split) == 4


def test_few_different_rows_are_exact_blocks() -> None:
    which = np.arange(N) % 8
    rows = RNG.random((8, N))
    found = recipe(rows[which])
    assert found.split == ("100 % 8 different rows: 8 exact pairs, one exposure",)
    assert terms(found) == {"relit": 1.0}
    lights, masks = found.programs["relit"].pairs(np.zeros((0, N), np.bool_), None)  # type: ignore[arg-type]
    np.testing.assert_allclose(masks.T @ lights * rows.max(), rows[which])
    assert recipe(np.ones((N, N))).split == ("100 % 1 different rows: 1 exact pair, one exposure",)


@pytest.mark.parametrize(("rank", "says"), [(1, "1 exact pair, "), (3, "3 exact pairs, ")])
def test_even_light_of_low_rank_is_a_few_exact_pairs(rank: int, says: str) -> None:
    seen, lit = 0.1 + RNG.random((rank, N)), 0.1 + RNG.random((rank, N))
    (line,) = recipe(seen.T @ lit).split
    assert line.startswith("100 % ") and line.endswith(f"{says}one exposure")


def test_sides_of_both_signs_take_two_exposures() -> None:
    seen, lit = RNG.standard_normal((2, N)), RNG.standard_normal((2, N))
    found = recipe(seen.T @ lit)
    assert found.split == ("100 % rank 2, of both signs: 4 exact pairs, two exposures",)
    assert terms(found) == {"even": 1.0}


def test_numbers_without_structure_are_taken_by_signed_codes() -> None:
    found = recipe(RNG.standard_normal((N, N)), codes=64)
    assert found.split == ("100 % anything: signed codes, two exposures: no structure was found",)
    assert terms(found) == {"relit": 1.0}


@pytest.mark.parametrize(("cells", "found"), [(7, True), (6, False)])
def test_matched_cells_of_one_weight_are_a_sixteenth_of_all(cells: int, found: bool) -> None:
    """108 cells: 6.75 of them."""
    partner = np.full(N, -1)
    partner[RNG.permutation(N)[:cells]] = RNG.permutation(N)[:cells]
    made = find_structure(1.0 - 0.4 * by_warp(partner), GRID)
    assert made.level == 1.0 and len(made.matches) == found
    assert (made.rest is None) == found
    if found:
        assert made.matches[0][0] == -0.4
        np.testing.assert_array_equal(made.matches[0][1], partner)


@pytest.mark.parametrize(("cells", "found"), [(4, True), (3, False)])
def test_of_few_cells_four_must_be_matched(cells: int, found: bool) -> None:
    matrix = np.ones((40, 40))
    matrix[[1, 11, 22, 33][:cells], [30, 7, 5, 18][:cells]] = 0.25
    made = find_structure(matrix, (5, 8))
    assert len(made.matches) == found and (made.rest is None) == found


@pytest.mark.parametrize(
    ("weights", "near"),
    [
        ([1.0], ((1.0, 1),)), ([1.0, 0.5], ((0.5, 1), (0.5, 2))),
        ([0.5, 0.5], ((0.5, 2),)), ([1.0, 0.75, 0.5], ()),
    ],
)  # fmt: skip
def test_bands_have_two_weights_at_most(
    weights: list[float], near: tuple[tuple[float, int], ...]
) -> None:
    grid = (14, 16)
    cells = np.arange(224)
    far = np.maximum(
        np.abs(cells[:, None] // 16 - cells // 16), np.abs(cells[:, None] % 16 - cells % 16)
    )
    matrix = 3.0 + np.r_[weights[0], weights, np.zeros(16)][far]
    made = find_structure(matrix, grid)
    assert made.near == near and made.level == 3.0
    np.testing.assert_allclose(made.rows(0, 224), matrix, atol=1e-9)


@pytest.mark.parametrize(("damaged", "found"), [(9, True), (10, False)])
def test_nine_tenths_of_a_ring_have_its_weight(damaged: int, found: bool) -> None:
    """99 cells have a neighbour to their right."""
    matrix = 2.0 - NearPart(GRID, 1).rows(0, N)
    cells = [row * 12 + col for col in range(11) for row in range(9)]
    for cell in cells[:damaged]:
        matrix[cell, cell + 1] = 2.0 + 0.1 * cell
    made = find_structure(matrix, GRID)
    assert made.near == (((-1.0, 1),) if found else ())


def test_rows_of_a_structure_are_those_of_its_sum() -> None:
    seen, lit = RNG.random((2, N)), RNG.random((2, N))
    matrix = seen.T @ lit + by_warp(WARP) - 0.5 * NearPart(GRID, 1).rows(0, N)
    made = find_structure(matrix, GRID)
    assert made.found and len(made.camera) == 2
    for start, stop in ((0, N), (3, 8), (100, N), (5, 5)):
        np.testing.assert_allclose(made.rows(start, stop), matrix[start:stop], atol=1e-6)
