"""Plans that follow what is known of the scene, or is found by the first photos of a pilot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from pdcd.bench.tables import Config
from pdcd.codes.hadamard import make_prior_codes
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.panels.patterns import read_pattern_levels
from pdcd.planning.guided import (
    can_be_guided,
    end_pilot,
    follow_prior,
    with_links,
)
from pdcd.planning.make import plan_with_prior
from pdcd.planning.pairs import (
    make_linked_pairs,
    resolve_family,
)
from pdcd.planning.plan import Plan
from pdcd.planning.prior import load_prior
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_draft_recipe
from pdcd.recipes.parts import derive_part_seed, randomise_signs

GRID = (3, 4)
CELLS = 12
LONG_S = 1000.0


def plan_of(**fields: Any) -> Plan:
    whole = {"goal": "indirect", "codes": 8, "window": "whole", **fields}
    return plan_with_prior(msgspec.convert(whole, CaptureRequest), Config(), GRID)


def bits_of(plan: Plan, program: str) -> NDArray[np.bool_]:
    """Lit code cells of each code, (K, L)."""
    lattice = Lattice(plan.grid, plan.window)
    primal = plan.patterns[program][0]
    cells = lattice.lattice_cells
    return np.array([read_pattern_levels(primal, k, cells) > 0.5 for k in range(len(primal))])


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"pilot": 4}, "a pilot of 4 codes finds nothing"),
        ({"pilot": 16, "codes": 32, "prior": "decay:3"}, "a prior and a pilot are both asked for"),
        ({"family": "balanced", "prior": "decay:3"}, "goal indirect, family balanced"),
        ({"goal": "white", "prior": "decay:3"}, "goal white, family none"),
        ({"goal": "fraction", "p": 0.25, "prior": "decay:3"}, "goal fraction"),
        ({"method": "multi-image", "prior": "decay:3"}, "cannot guide"),
        ({"prior": "decay:0"}, "names no distance above 0"),
    ],
)
def test_what_cannot_be_followed_is_refused(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(RequestError, match=words) as caught:
        plan_of(**fields)
    assert caught.value.hint


@pytest.mark.parametrize(
    ("fields", "fits"),
    [
        ({}, True),
        ({"goal": "short-range", "radius": 1}, True),
        ({"codes": 16, "parts": 2}, True),
        ({"family": "balanced"}, False),
        ({"goal": "fraction", "p": 0.25}, False),
        ({"goal": "fraction", "p": 0.5}, True),
        ({"goal": "white"}, False),
        ({"goal": "off-diagonal", "shift": [0, 1], "p": 0.5}, False),
        ({"goal": "warped", "warp": np.arange(12)[::-1].reshape(GRID).tolist()}, False),
        ({"goal": "filtered", "kernel": np.eye(3).tolist()}, False),
    ],
)
def test_hadamard_codes_of_cells_with_themselves_can_be_guided(
    fields: dict[str, Any], fits: bool
) -> None:
    assert can_be_guided(plan_of(**fields)) is fits


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("parts", [1, 2])
def test_codes_follow_the_links_between_all_code_cells_of_two_cells(
    window: str, parts: int
) -> None:
    """With quarter windows a cell is served by itself, and the code cells right of it and below."""
    plan = plan_of(window=window, codes=8 * parts, parts=parts, seed=5)
    rng = np.random.default_rng(3)
    links = np.where(rng.random((CELLS, CELLS)) < 0.3, rng.random((CELLS, CELLS)), 0.0)
    shape = GRID if window == "whole" else (4, 5)
    serves = np.zeros((shape[0] * shape[1], CELLS))
    for cell in range(CELLS):
        row, column = divmod(cell, 4)
        around = [(0, 0)] if window == "whole" else [(0, 0), (0, 1), (1, 0), (1, 1)]
        for down, right in around:
            serves[(row + down) * shape[1] + column + right, cell] = 1.0 / len(around)
    between = serves @ links @ serves.T
    found = with_links(plan, scipy.sparse.csr_array(links), 5)
    assert found.patterns.keys() == plan.patterns.keys() and found.recipe is plan.recipe
    for part, name in enumerate(plan.patterns, start=1):
        seed = derive_part_seed(5, parts, part if parts > 1 else 0)
        wanted = make_prior_codes(
            shape, 8, between, np.random.Generator(np.random.PCG64(seed)), apart=parts > 1
        )
        if parts > 1:
            wanted = randomise_signs(wanted, seed)
        assert np.array_equal(bits_of(found, name), wanted)
        dual = found.patterns[name][1]
        shut = np.array([read_pattern_levels(dual, k, wanted.shape[1]) < 0.5 for k in range(8)])
        assert np.array_equal(shut, wanted)


def test_no_links_leave_the_usual_codes_and_other_programs_alone() -> None:
    none = scipy.sparse.csr_array((CELLS, CELLS))
    for window, seed in (("whole", 0), ("quarter", 0), ("whole", 4)):
        plan = plan_of(window=window, seed=seed)
        found = make_linked_pairs(plan, none, seed)
        assert np.array_equal(found["coded"][0], plan.patterns["coded"][0])
    assert set(make_linked_pairs(plan_of(codes=32, pilot=16), none, 0)) == {"coded"}
    assert make_linked_pairs(plan_of(goal="fraction", p=0.25, codes=64), none, 0) == {}


def test_a_prior_keeps_what_it_links_apart_and_is_named() -> None:
    links = np.zeros((CELLS, CELLS))
    links[0, 11] = links[5, 2] = 1.0
    prior = replace(load_prior("decay:2", GRID), links=scipy.sparse.csr_array(links), name="mine")
    plan = plan_of()
    found = follow_prior(plan, prior, 0)
    assert found.prior == "mine" and plan.prior is None
    codes = bits_of(found, "coded")
    for n, m in ((0, 11), (5, 2)):
        assert (codes[:, n] != codes[:, m]).any()
    asked = plan_of(prior="decay:2")
    assert asked.prior == "decay 2 cells"
    same = follow_prior(plan, load_prior("decay:2", GRID), 0)
    assert np.array_equal(bits_of(asked, "coded"), bits_of(same, "coded"))


@pytest.mark.parametrize(
    ("limit_s", "codes"), [(LONG_S, 44), (2.31, 44), (2.29, 40), (2.11, 40), (2.09, 36), (1.71, 32)]
)
def test_codes_of_a_pilot_that_ends_go_to_the_photo(limit_s: float, codes: int) -> None:
    """Of 32 codes in 1.6 s, and 0.1 s on black: 44 where there is a matrix and time for it."""
    plan = replace(plan_of(codes=48, pilot=16), iso=400)
    short = end_pilot(plan, 0, limit_s)
    assert (short.how.codes, short.how.pilot, short.how.coded) == (codes + 4, 4, codes)
    assert len(short.patterns["coded"][0]) == codes and len(short.patterns["pilot"][0]) == 4
    for side in (0, 1):
        whole = plan.patterns["pilot"][side]
        assert np.array_equal(short.patterns["pilot"][side], whole[:4])
    assert len(short.recipe.stack) == 4 and short.iso == 400
    told = plan.summary(limit_s)
    cost = told.pilot_cost
    assert cost is not None
    assert (cost.raw_files, cost.scouts, cost.stopped_codes) == (16, 4, codes)
    # A single code is shown for as long as its share of the photo's time, and 0.1 s on black.
    single_s = [plan.exposure_s(shot) for shot in plan.recipe.shots if shot.only is not None]
    assert cost.seconds == pytest.approx(sum(single_s)) and len(single_s) == 16
    assert cost.stopped_raw_files == told.raw_files - 12
    more_s = 1.6 * codes / 32 - 1.6
    assert cost.stopped_seconds == pytest.approx(told.seconds - 0.75 * sum(single_s) + more_s)


def test_a_pilot_that_ends_leaves_parts_of_a_size_that_there_is() -> None:
    """Of 4 parts of 8 codes: 12 more codes make 4 of 8 still, or 40 make 4 of 12 at last."""
    few = end_pilot(plan_of(codes=48, pilot=16, parts=4), 0, LONG_S)
    assert (few.how.coded, few.how.parts) == (32, 4)
    more = end_pilot(plan_of(codes=64, pilot=32, parts=4), 0, LONG_S)
    assert (more.how.coded, more.how.parts, more.how.pilot) == (48, 4, 4)


def test_another_plan_takes_the_place_of_a_pilot_that_finds_nothing() -> None:
    plan = replace(plan_of(codes=16, pilot=16), iso=800)
    other = plan.otherwise
    assert other is not None
    short = end_pilot(plan, 0, LONG_S)
    assert short.iso == 800 and short.how == other.how and short.recipe is other.recipe
    cost = plan.summary(LONG_S).pilot_cost
    assert cost is not None
    told = other.summary()
    assert (cost.stopped_codes, cost.stopped_raw_files) == (12, told.raw_files)
    assert cost.stopped_seconds == told.seconds and cost.raw_files == 16
    assert other.summary(LONG_S).pilot_cost is None
    assert plan_of().summary(LONG_S).pilot_cost is None


@pytest.mark.parametrize(
    ("asked", "default", "fields", "how", "family"),
    [
        (None, "hadamard", {"name": "indirect"}, {}, "hadamard"),
        ("bernoulli", "hadamard", {"name": "indirect"}, {}, "bernoulli"),
        (None, "balanced", {"name": "indirect"}, {}, "balanced"),
        (None, "hadamard", {"name": "fraction", "p": 0.25}, {"codes": 64}, "hadamard"),
        (None, "hadamard", {"name": "fraction", "p": 0.25}, {"codes": 96}, "balanced"),
        ("hadamard", "hadamard", {"name": "fraction", "p": 0.25}, {"codes": 96}, "hadamard"),
        (None, "bernoulli", {"name": "fraction", "p": 0.25}, {"codes": 96}, "bernoulli"),
        (None, "hadamard", {"name": "fraction", "p": 0.25}, {"codes": 64, "parts": 2}, "balanced"),
        (None, "hadamard", {"name": "fraction", "p": 0.5}, {"codes": 64, "parts": 2}, "hadamard"),
        (None, "hadamard", {"name": "white"}, {}, "hadamard"),
    ],
)
def test_other_codes_stand_in_where_hadamard_ones_cannot_be_made(
    asked: Any, default: Any, fields: dict[str, Any], how: dict[str, Any], family: str
) -> None:
    whole = CaptureScheme(**{"codes": 64, **how})
    draft = make_draft_recipe(Target(msgspec.convert(fields, Goal), GRID), whole)
    assert resolve_family(asked, default, draft, whole) == family


@pytest.mark.parametrize(
    ("radius", "codes", "share", "coins"),
    [
        (1, 8, 1 / 8, 1 / 8), (1, 16, 1 / 16, 2 / 16), (1, 64, 3 / 64, 6 / 64),
        (2, 16, 1 / 16, 1 / 16),
    ],
)  # fmt: skip
def test_far_light_has_codes_of_half_the_share_that_is_best(
    radius: int, codes: int, share: float, coins: float
) -> None:
    """Of 3 x 3 cells and one more a tenth is best, of 5 x 5 and one more 1/26; at least one code.
    Coins are thrown for that, all others light half as many."""
    request = CaptureRequest(
        goal="long-range", radius=radius, codes=codes, window="whole", grey_masks=False
    )
    plan = plan_with_prior(request, Config(), (12, 16))
    assert plan.family == "balanced"
    assert np.array_equal(bits_of(plan, "far").mean(axis=0), np.full(192, share))
    thrown = plan_with_prior(
        msgspec.structs.replace(request, family="bernoulli"), Config(), (12, 16)
    )
    lit = bits_of(thrown, "far")
    assert lit.mean() == pytest.approx(coins, rel=0.1) and np.ptp(lit.mean(axis=0)) > 0.0


@pytest.mark.parametrize(
    ("fields", "family"),
    [
        ({"p": 0.25, "codes": 32, "shift": (2, 3)}, "balanced"),
        ({"p": 0.25, "codes": 64, "shift": (2, 3)}, "hadamard"),
        ({"p": 0.125, "codes": 64, "shift": (0, 5)}, "balanced"),
        ({"p": 0.25, "codes": 32}, "hadamard"),
        ({"p": 0.25, "codes": 32, "shift": (2, 3), "family": "hadamard"}, "hadamard"),
        ({"p": 0.1, "codes": 100, "shift": (-1, 4)}, "balanced"),
    ],
)
def test_cells_matched_with_others_are_lit_with_them_as_often_as_by_chance(
    fields: dict[str, Any], family: str
) -> None:
    """So that their own light has the share that is wanted, exactly where p^2 K is whole."""
    plan = plan_with_prior(
        CaptureRequest(goal="fraction", window="whole", **fields), Config(), (12, 16)
    )
    assert plan.family == family
    if family == "hadamard":
        return
    bits = bits_of(plan, "coded")
    down, right = fields["shift"]
    for row, col in ((4, 6), (5, 5), (8, 9)):
        other = (row + down) * 16 + col + right
        met = np.sum(bits[:, row * 16 + col] & bits[:, other])
        assert abs(met - fields["p"] ** 2 * fields["codes"]) < 1e-9
