"""Goals of off-axis benches, against sums over patterns and paths written out here."""

from __future__ import annotations

from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import Config, RigConfig, ScheduleConfig
from pdcd.errors import RequestError
from pdcd.panels.frames import FrameLog
from pdcd.panels.patterns import read_pattern_levels
from pdcd.pictures.exposed import ComputedShot
from pdcd.planning.make import make_plan
from pdcd.planning.plan import Plan
from pdcd.probing.realised import Factors, collect_factors, compute_bench_factors
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.recipe import Shot
from pdcd.sensor.cells import CellMap
from pdcd.virtual.scene.displaced import DisplacedEffect
from pdcd.virtual.scene.effects import DenseEffect
from pdcd.virtual.scene.scene import Scene
from tests.combined import combine_shots

GRID = (6, 10)
ROWS, COLS = GRID
N = ROWS * COLS
RNG = np.random.default_rng(5)
WARP = np.where(RNG.random(GRID) < 0.1, -1, RNG.integers(0, N, GRID))
MAP = np.round(RNG.uniform(-3.0, 3.0, GRID), 2)
TILT = (0.98, 0.03, 0.06, 0.02, 1.01, -0.03, 0.05, 0.02, 1.0)


def config(**tables: Any) -> Config:
    return Config(
        **{
            "rig": RigConfig(arrangement="off-axis"),
            "schedule": ScheduleConfig(window="whole"),
            **tables,
        }
    )


def planned(grid: tuple[int, int] = GRID, **fields: Any) -> Plan:
    return make_plan(msgspec.convert(fields, CaptureRequest), config(), grid)


def realised(plan: Plan, program: str) -> np.ndarray:
    """Sum over the pairs of a program of mask times light, (N, N): no code of the probing room."""
    primal, dual = plan.patterns[program]
    cells = plan.grid[0] * plan.grid[1]
    light = np.array(
        [read_pattern_levels(primal, k, cells) for k in range(len(primal))], dtype=float
    )
    mask = np.array([read_pattern_levels(dual, k, cells) for k in range(len(dual))], dtype=float)
    return np.asarray(mask.T @ light)


def shown_on_time(plan: Plan, shot: Shot, scene: Scene) -> Factors:
    """Probing matrix of a shot on panels that miss nothing."""
    frames, rig = plan.frames(shot), config()
    rows = np.arange(len(frames), dtype=np.int32)
    settle_ns, period_ns = round(plan.settle_s * 1e9), 1e9 / plan.row_hz
    at_ns = settle_ns + np.rint(np.arange(rows.size + 1) * period_ns).astype(np.int64)
    missed = np.zeros(rows.size, dtype=np.int32)
    log = FrameLog(rows, rows, at_ns[:-1], at_ns[:-1], at_ns[[-1, -1]], missed, "test", True)
    factors = compute_bench_factors(
        frames, log, rig.projector, rig.mask,
        open_ns=0, close_ns=int(at_ns[-1]) + settle_ns, displacement=scene.displacement,
    )  # fmt: skip
    return collect_factors(factors)


def pictures(plan: Plan, scene: Scene) -> dict[str, np.ndarray]:
    shots = {}
    for shot in plan.recipe.shots:
        matrix = shown_on_time(plan, shot, scene)
        light = scene.photo(
            matrix.left, matrix.right, matrix.coaxial, matrix.open_s, matrix.displaced
        ).reshape(*plan.grid, 3)
        dark = np.zeros(plan.grid, np.bool_)
        shots[shot.name] = ComputedShot(light, np.zeros_like(light), dark, matrix, {})
    found = combine_shots(plan.recipe, shots, CellMap.block(plan.grid, plan.grid))
    return {name: picture.image[..., 0] for name, picture in found.items()}


def partner(n: int, source: str, disparity: int) -> int:
    """The match of a camera cell, one by one."""
    row, col = divmod(n, COLS)
    if source == "warp":
        if WARP.flat[n] < 0:
            return -1
        row, col = divmod(int(WARP.flat[n]), COLS)
    elif source == "disparities":
        col = int(np.floor(col + 0.5 + MAP.flat[n]))
    elif source == "plane":
        centre = np.array([[[(col + 0.5) / COLS, (row + 0.5) / ROWS]]])
        x, y = cv2.perspectiveTransform(centre, np.array(TILT).reshape(3, 3))[0, 0]
        row, col = int(np.floor(y * ROWS)), int(np.floor(x * COLS))
    col += disparity
    return row * COLS + col if 0 <= row < ROWS and 0 <= col < COLS else -1


FIELDS: dict[str, dict[str, Any]] = {
    "itself": {},
    "warp": {"warp": WARP.tolist()},
    "disparities": {"disparities": MAP.tolist()},
    "plane": {"plane": list(TILT)},
}


@pytest.mark.parametrize("source", FIELDS)
@pytest.mark.parametrize("disparity", [0, -3])
def test_k5_t2_what_is_keyed_never_meets_and_all_else_does(source: str, disparity: int) -> None:
    """Table 2, row 2 with a_n in the place of n: exactly 0, whatever the number of codes."""
    fields = {"disparity": [disparity, disparity], **FIELDS[source]}
    plan = planned(goal="keyed", codes=64, **fields)
    pi = realised(plan, "keyed")
    blocked = 0
    for n in range(N):
        a = partner(n, source, disparity)
        rest = np.ones(N, bool)
        if a >= 0:
            assert pi[n, a] == 0.0
            rest[a] = False
            blocked += 1
        # 64 codes for 60 cells: exact, but where there is nothing to block: in its row alone.
        if a < 0:
            rest = np.arange(N) // COLS == n // COLS
        assert (pi[n, rest] == 16.0).all()
        assert pi[n].sum() == pytest.approx(16.0 * (N - 1), abs=40)
    assert blocked > N // 2
    wanted = plan.recipe.wanted.dense()
    expected = np.ones((N, N))
    for n in range(N):
        if (a := partner(n, source, disparity)) >= 0:
            expected[n, a] = 0.0
    np.testing.assert_array_equal(wanted, expected)


@pytest.mark.parametrize(("source", "seed"), [("itself", 0), ("disparities", 1), ("warp", 0)])
def test_a_range_of_depths_is_exactly_dark_and_the_rest_of_the_row_even(
    source: str, seed: int
) -> None:
    low, high = -1, 2
    fields = {"disparity": [low, high], "seed": seed, **FIELDS[source]}
    plan = planned(goal="keyed", codes=60, **fields)
    pi = realised(plan, "keyed")
    beside = realised(plan, "other-rows")
    period = 15  # the least is 10 + 1 + 4; four combs in 60 codes
    for n in range(N):
        closed = {partner(n, source, d) for d in range(low, high + 1)} - {-1}
        assert not pi[n, list(closed)].any()
        row = n // COLS
        if source != "warp":
            line = {row * COLS + c for c in range(COLS)}
            # Other depths of the row: no chance in it.
            assert (pi[n, list(line - closed)] == 60 // period).all()
            assert not beside[n, list(line)].any()
            others = list(set(range(N)) - line)
            assert (beside[n, others] == 30.0).all()
    # Over cells and rows light from other rows has the share that the second photo brings up to 1.
    other = np.arange(N)[:, None] // COLS != np.arange(N)[None, :] // COLS
    if source != "warp":
        assert pi[other].mean() == pytest.approx((60 / period) * (1.0 - 4 / period), rel=0.05)


def scene_of(disparity: float, *, haze: float = 0.3, grid: tuple[int, int] = GRID) -> Scene:
    """A plane at one disparity, in an even haze."""
    cells = grid[0] * grid[1]
    moved = np.tile([0.0, disparity], (cells, 1))
    places = np.arange(cells) % grid[1] + 0.5 + disparity
    moved[(places <= 0) | (places >= grid[1])] = np.nan
    effects = (
        DisplacedEffect("plane", grid, np.full(cells, 0.6), moved),
        DenseEffect("haze", np.full((cells, cells), haze / cells)),
    )
    return Scene("plane", grid, effects)


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("disparity", [0.0, 0.25, 0.375, 0.75, 1.0, -0.6])
def test_fig11_a_plane_comes_back_as_it_leaves_the_keyed_depth(
    window: str, disparity: float
) -> None:
    """Brightness over disparity d, in cells: |d| through whole cells; (|d| - 1/4) / (1/2) through
    quarter windows, dark up to a quarter cell."""
    grid = (5, 12)
    request = CaptureRequest(goal="keyed", codes=128, window=window)  # type: ignore[arg-type]
    plan = make_plan(request, config(), grid)
    image = pictures(plan, scene_of(disparity, haze=0.0, grid=grid))["keyed"][1:-1, 2:-2]
    d = abs(disparity)
    curve = min(1.0, d) if window == "whole" else float(np.clip((d - 0.25) / 0.5, 0.0, 1.0))
    # The weight of a photo is that of all paths; windows see a little less of near ones.
    np.testing.assert_allclose(image, 0.6 * curve, rtol=0.03, atol=1e-12)


@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_fig4b_the_keyed_plane_leaves_half_a_percent_and_others_stay(window: str) -> None:
    grid = (8, 16)
    request = CaptureRequest(goal="keyed", codes=128, disparity=(2, 2), window=window)  # type: ignore[arg-type]
    plan = make_plan(request, config(), grid)
    haze = 0.3 * (1.0 - 1.0 / (grid[0] * grid[1]))
    for disparity in (-3, 1, 2):
        image = pictures(plan, scene_of(disparity, grid=grid))["keyed"]
        sees = np.arange(16) + disparity
        inside = image[:, (sees >= 0) & (sees < 16) & (np.arange(16) < 14)] - haze
        if disparity == 2:
            assert np.abs(inside).max() < 0.005 * 0.6
        else:
            np.testing.assert_allclose(inside, 0.6, rtol=0.02)


@pytest.mark.parametrize("goal", ["keyed", "stereo"])
@pytest.mark.parametrize("disparity", [(1, 1), (-1, 2)])
def test_photos_are_the_dense_sums(goal: str, disparity: tuple[int, int]) -> None:
    plan = planned(goal=goal, codes=60, disparity=list(disparity))
    rng = np.random.default_rng(3)
    paths = rng.random((N, N)) * 0.01
    moved = np.stack([np.zeros(N), rng.integers(-3, 4, N)], axis=1).astype(float)
    albedo = rng.random(N)
    direct = DisplacedEffect("direct", GRID, albedo, moved)
    scene = Scene("any", GRID, (direct, DenseEffect("paths", paths)))
    whole = paths.copy()
    for n in range(N):
        c = n % COLS + int(moved[n, 1])
        if 0 <= c < COLS:
            whole[n, n - n % COLS + c] += albedo[n]
    image = pictures(plan, scene)[goal].ravel()
    # Of the patterns alone: what every path weighs, and what each photo is to be divided by.
    wanted = {photo.name: photo.wanted.dense() for photo in plan.recipe.photos}
    expected = np.zeros(N)
    assert isinstance(plan.recipe.answer, tuple)
    for share, name in plan.recipe.answer:
        pi = np.ones((N, N)) if name == "white" else realised(plan, name)
        by_row = next(p.row_weights for p in plan.recipe.photos if p.name == name)
        axis = 1 if by_row else None
        weight = (pi * wanted[name]).sum(axis=axis) / (wanted[name] ** 2).sum(axis=axis)
        expected += share * (pi * whole).sum(axis=1) / weight
    np.testing.assert_allclose(image, expected, rtol=1e-9, atol=1e-12)
    truth = ((plan.recipe.wanted.dense()) * whole).sum(axis=1)
    assert np.sqrt(np.mean((image - truth) ** 2) / np.mean(truth**2)) < 0.05


@pytest.mark.parametrize(("keep", "rows"), [("in", 8), ("out", 12)])
def test_24_epipolar_paths_are_exact_at_as_many_codes_as_rows(keep: str, rows: int) -> None:
    grid = (rows, 7)
    cells = rows * 7
    rng = np.random.default_rng(rows)
    paths = rng.random((cells, cells))
    scene = Scene("any", grid, (DenseEffect("paths", paths),))
    plan = planned(grid, goal="epipolar", keep=keep, codes=rows, seed=2)
    truth = np.zeros(cells)
    for n in range(cells):
        for m in range(cells):
            if (n // 7 == m // 7) == (keep == "in"):
                truth[n] += paths[n, m]
    image = pictures(plan, scene)["epipolar"].ravel()
    np.testing.assert_allclose(image, truth, rtol=1e-12)
    # With half of the codes it is not: the test above could fail.
    few = planned(grid, goal="epipolar", keep=keep, codes=4, seed=2)
    assert np.abs(pictures(few, scene)["epipolar"].ravel() - truth).max() > 1e-3 * truth.max()


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"goal": "keyed", "disparity": [2, 1]}, "lower one first"),
        ({"goal": "stereo", "disparity": [-60000, -60000]}, "leave a row"),
        ({"goal": "keyed", "plane": [1, 0, 0, 0, 1, 0, -1, 0, 0.5]}, "to infinity"),
        ({"goal": "keyed", "plane": [0] * 9}, "plane: "),
        ({"goal": "keyed", "plane": list(TILT), "warp": WARP.tolist()}, "both plane and warp"),
        ({"goal": "keyed", "disparities": MAP.tolist(), "warp": WARP.tolist()}, "both disparities"),
        ({"goal": "keyed", "disparities": [[1.0]]}, "the grid is"),
        ({"goal": "keyed", "keep": "in"}, "takes no keep"),
        ({"goal": "epipolar", "disparity": [0, 1]}, "takes no disparity"),
        ({"goal": "indirect", "plane": list(TILT)}, "takes no plane"),
        ({"goal": "keyed", "codes": 12, "disparity": [0, 1], "family": "bernoulli"}, "family"),
        ({"goal": "keyed", "codes": 64, "pilot": 16}, "no pilot"),
        ({"goal": "keyed", "codes": 12, "disparity": [-1, 2]}, "at least 16 codes"),
        ({"goal": "stereo", "codes": 32, "parts": 4, "disparity": [0, 1]}, "for each part"),
        ({"goal": "keyed", "smooth": True}, "to smooth"),
    ],
)
def test_depths_that_cannot_be_are_refused(fields: dict[str, Any], what: str) -> None:
    with pytest.raises(RequestError) as caught:
        planned(**fields)
    assert what in f"{caught.value.message} {caught.value.hint}"
