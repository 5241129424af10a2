"""Leaks and their remedies (rows L1 to L4), and errata, as numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdcd.codes.make import make_codes
from pdcd.panels.lattice import Lattice
from pdcd.probing.panel import PanelOptics
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.programs import CodedProgram
from tests.catalogue_rig import photo, scene_of, show, transport

GRID = (4, 5)
N = 20
T = transport(N)
AMBIENT = 0.3
EPS, DELTA = 0.02, 0.01
"""What the black mask and the black projector let through."""

CODES = make_codes("balanced", GRID, 16, dual="complement", seed=1)
LIT, OPEN = CODES.primal + 0.0, CODES.dual + 0.0


def exposure(primal_black: bool = False, dual_black: bool = False, eps: float = EPS) -> Any:
    """One leaking photo without guards and settling, so that sums over codes are short to write."""
    shown = show(
        LIT, OPEN, GRID, guards=False, projector=PanelOptics(leak=DELTA),
        mask=PanelOptics(leak=eps),
        primal_black=primal_black, dual_black=dual_black,
    )  # fmt: skip
    return photo(shown, scene_of(T, GRID, AMBIENT))


def leaking_projector(lit: Any) -> Any:
    return DELTA + (1.0 - DELTA) * lit


def test_l1_photo_with_a_black_mask_removes_what_the_mask_leaks() -> None:
    """(1 - eps) sum of m (T i' + ambient) is left: the projector's leak and the room."""
    left = exposure() - exposure(dual_black=True)
    want = (1.0 - EPS) * sum(
        m * (T @ leaking_projector(i) + AMBIENT) for m, i in zip(OPEN, LIT, strict=True)
    )
    np.testing.assert_allclose(left, want, rtol=1e-12)


def test_l2_photo_with_a_black_projector_removes_ambient_and_its_own_leak() -> None:
    """(1 - delta) sum of m' T i is left: what the mask leaks."""
    left = exposure() - exposure(primal_black=True)
    masks = EPS + (1.0 - EPS) * OPEN
    want = (1.0 - DELTA) * sum(m * (T @ i) for m, i in zip(masks, LIT, strict=True))
    np.testing.assert_allclose(left, want, rtol=1e-11)


def test_l3_four_photos_remove_all_of_it() -> None:
    plain = sum(m * (T @ i) for m, i in zip(OPEN, LIT, strict=True))
    four = exposure() - exposure(dual_black=True) - exposure(True) + exposure(True, True)
    np.testing.assert_allclose(four, (1.0 - EPS) * (1.0 - DELTA) * plain, rtol=1e-11)
    assert np.abs(exposure() / plain - 1.0).max() > 0.5  # without, it is far off


@pytest.mark.parametrize(("guards", "excess"), [(False, 9 / 300), (True, 29 / 300)])
def test_l4_a_mask_of_300_to_1_spoils_indirect_light_by_percents(
    guards: bool, excess: float
) -> None:
    """Direct 1, indirect 1/4. The leak passes half of all light, T 1 / 2 = 0.625, where a quarter
    of the indirect is wanted, 0.0625: 10 eps, less eps for the code's own share. Guard refreshes
    leave the projector lit and triple the leak."""
    eps = 1 / 300
    scene = np.full((N, N), 0.25 / (N - 1))
    np.fill_diagonal(scene, 1.0)
    codes = make_codes("hadamard", GRID, 32, dual="complement", seed=1)
    shown = show(codes.primal, codes.dual, GRID, guards=guards, mask=PanelOptics(leak=eps))
    seen = photo(shown, scene_of(scene, GRID)) / 32 * 4.0
    np.testing.assert_allclose(seen / 0.25 - 1.0, excess, rtol=1e-9)


def test_x8_difference_of_shifted_photos_has_weight_p_times_one_less_p() -> None:
    """(i, i) less (i, i shifted): 1 on the diagonal and -1 beside it, times 1/4, not times 1."""
    bits = make_codes("hadamard", GRID, 32, dual="same", seed=2).primal
    matrices = []
    for partner in (None, (0, -1)):
        light, mask = CodedProgram(partner, False).pairs(bits, Lattice(GRID))
        matrices.append(np.asarray(mask, float).T @ np.asarray(light, float) / 32)
    difference = matrices[0] - matrices[1]
    for n in range(N):
        if n % GRID[1] == 0:
            continue  # no neighbour: closed in the second photo
        want = np.zeros(N)
        want[n], want[n - 1] = 0.25, -0.25
        np.testing.assert_allclose(difference[n], want, atol=1e-15)


def test_x10_distance_is_two_dimensional() -> None:
    """The last cell of a row and the first of the next are neighbours as numbers only."""
    wanted = make_recipe(
        Target(Goal(name="long-range", radius=1), GRID), CaptureScheme()
    ).wanted.dense()
    last, first = GRID[1] - 1, GRID[1]
    assert wanted[last, first] == 1.0
    assert wanted[0, GRID[1] + 1] == 0.0  # diagonal neighbours, 6 apart as numbers
    assert wanted[0, 2 * GRID[1]] == 1.0  # two rows down in the same column


def test_x11_shifts_have_one_sign_and_filters_the_other() -> None:
    """off-diagonal w: m = n + w. filtered: n = m + w, so its tap at -w is the same picture."""
    shift = (1, -2)
    kernel = np.zeros((3, 5))
    kernel[1 - shift[0], 2 - shift[1]] = 1.0
    shifted = make_recipe(
        Target(Goal(name="off-diagonal", shift=shift), GRID), CaptureScheme()
    ).wanted.dense()
    filtered = make_recipe(
        Target(Goal(name="filtered"), GRID, matrices={"kernel": kernel}), CaptureScheme()
    ).wanted.dense()
    np.testing.assert_array_equal(shifted, filtered)
    assert shifted[2, 1 * GRID[1] + 0] == 1.0  # from (0, 2) down 1, left 2
