"""Error bars, corrections, leaks, slices and rasters are what they were when benchmarks were taken.

`tests/data/pictures.json` has what each makes of light that is made up. Where one is changed on
purpose, write it anew by ``python -m tests.unit.pictures.test_sums_golden``, and measure again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.panels.map import Map
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.pictures.bars import add_known_errors
from pdcd.pictures.exposed import ComputedShot, ExposedShot
from pdcd.pictures.leaks import DarkPhotoLight, LeakAnswer, ShotMeans, make_leak_answers
from pdcd.pictures.photos import make_corrected_photos
from pdcd.pictures.picture import Picture, with_error_bars
from pdcd.pictures.row import MatrixRow
from pdcd.pictures.sigma import measure_error_bars
from pdcd.pictures.smooth import compute_colour_correction
from pdcd.pictures.software import sum_stack_matrices, sum_stack_shots
from pdcd.pictures.to_cells import average_picture, average_shots, average_with_errors
from pdcd.pictures.to_quads import QuadWeights, compute_direct_share, spread_errors
from pdcd.pictures.transport import draw_transport_slice, solve_transport_slice
from pdcd.pictures.upright import FieldSampler, FieldView
from pdcd.probing.realised import Factors
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.recipes.recipe import Recipe
from pdcd.sensor.cells import CellMap
from pdcd.verdict.evidence import PixelSample
from tests.combined import combine_shots
from tests.golden import alike, keep, kept_in, plain
from tests.places import DATA

GOLDEN = DATA / "pictures.json"
GRID = (6, 8)
N = 48
TURNED = Placing(turn_deg=7.0, scale=0.85, offset_px=(20.0, -13.0))
LENS = Placing(turn_deg=-2.0, scale=0.9, radial=(0.03, -0.01), tangential=(0.004, 0.002))


def map_of(place: Placing, frame: tuple[int, int]) -> Map:
    return make_placed_map(place, (frame[1], frame[0]), (1024, 768), "camera")


CELLS = {
    "one quad": CellMap.block(GRID, GRID),
    "blocks": CellMap.block(GRID, (18, 24)),
    "turned": CellMap(grid=GRID, frame=(29, 41), map=map_of(TURNED, (29, 41)), blur_quads=0.6),
    "lens": CellMap(grid=GRID, frame=(40, 57), map=map_of(LENS, (40, 57))),
}


def shots_of(recipe: Recipe, cells: CellMap, seed: int = 0) -> dict[str, ExposedShot]:
    """Light and codes by chance; a few quads of the last shot are saturated."""
    rng = np.random.default_rng(seed)
    found: dict[str, ExposedShot] = {}
    for k, shot in enumerate(recipe.shots):
        codes = 1 if shot.only is not None else 20
        lit = rng.random((codes, N)) < 0.5
        left = np.where(lit, 0.02, 0.9) if shot.program else np.ones((codes, N))
        right = np.where(lit, 1.0, 0.01) if shot.program else np.ones((codes, N))
        gate = 0.03 if shot.dual_black else 1.0
        factors = Factors(
            gate * left, right, gate * np.einsum("rn,rn->n", left, right), gate * left.sum(axis=0)
        )
        smooth = 1.0 + 0.5 * np.sin(np.arange(cells.frame[0])[:, None, None] / 7.0)
        light = codes * gate * smooth * rng.uniform(0.4, 0.6, (*cells.frame, 3))
        blown = np.zeros(cells.frame, np.bool_)
        blown[2:4, 1:3] = k == len(recipe.shots) - 1
        variance = 1e-3 * light + 1e-4
        found[shot.name] = ComputedShot(light, variance, blown, factors, {}, missed=k % 2)
    return found


def recipe(name: Any, how: CaptureScheme, **numbers: Any) -> Recipe:
    return make_recipe(Target(Goal(name=name, **numbers), GRID), how)


def pictures(found: dict[str, Picture]) -> Any:
    return {name: [one.image, one.sigma] for name, one in found.items()}


def combined() -> Any:
    told = {}
    for kind, cells in CELLS.items():
        for normalise in ("auto", "row", "scalar"):
            for goal, numbers in (("direct", {}), ("split", {"period": 4})):
                one = recipe(goal, CaptureScheme(black_level="mask"), **numbers)
                shots = shots_of(one, cells)
                made = combine_shots(one, shots, cells, normalise=normalise)
                told[f"{kind}, {normalise}, {goal}"] = pictures(made)
        one = recipe("direct", CaptureScheme())
        told[f"{kind}, whole"] = pictures(combine_shots(one, shots_of(one, cells), cells))
    return told


def corrected() -> Any:
    told = {}
    for kind, cells in CELLS.items():
        for goal, numbers in (("indirect", {}), ("short-range", {"radius": 1})):
            one = recipe(goal, CaptureScheme(), **numbers)
            shots = shots_of(one, cells, 1)
            found = make_corrected_photos(one, shots, None, cells, normalise="auto", smooth=True)
            told[f"{kind}, {goal}"] = pictures(found)
    return told


def smoothed() -> Any:
    rng = np.random.default_rng(2)
    told = {}
    for grid in ((6, 8), (1, 20), (12, 5)):
        cells = grid[0] * grid[1]
        lit = rng.random((16, cells)) < 0.5
        left, right = np.where(lit, 0.0, 1.0), np.where(lit, 1.0, 0.02)
        image = rng.uniform(0.2, 1.0, (cells, 3)) + np.linspace(0.0, 1.0, cells)[:, None]
        image[3] = -0.1
        own = 4.0 + rng.random(cells)
        for name, weight in (("one weight", 4.0), ("own weights", own)):
            for beyond in (0, 1, 2):
                more = compute_colour_correction(left, right, weight, image, grid, beyond=beyond)
                told[f"{grid}, {name}, beyond {beyond}"] = more
    return told


def bars() -> Any:
    rng = np.random.default_rng(3)
    image = rng.uniform(0.1, 1.0, (*GRID, 3))
    sigma = np.full(image.shape, 0.01)
    sigma[0, 0] = np.inf
    picture = Picture(image, sigma)
    told: dict[str, Any] = {}
    for count in (4, 8):
        parts = [image + 0.05 * rng.standard_normal(image.shape) * image for _ in range(count)]
        made = measure_error_bars(picture, parts)
        told[f"{count} parts"] = [made.sigma, made.sensor, made.code]
    single = with_error_bars(
        Picture(image, sigma.astype(np.float32)), 0.02 * image.astype(np.float32), "sensor"
    )
    told["single precision"] = [single.sigma, single.kind]
    for kind, cells in CELLS.items():
        one = recipe("short-range", CaptureScheme(), radius=1)
        shots = shots_of(one, cells, 4)
        photos = make_corrected_photos(one, shots, None, cells, normalise="auto", smooth=False)
        made_of = combine_shots(one, shots, cells)
        beside = {name: rng.random((*GRID, 3)) for name in made_of}
        found = {}
        for name, alone in add_known_errors(one, made_of).items():
            code = spread_errors(beside[name], alone, average_picture(alone, cells).image, cells)
            found[name] = with_error_bars(Picture(alone.image, alone.sensor), code, alone.kind)
        told[f"alone, {kind}"] = {name: [made.sigma, made.code] for name, made in found.items()}
        means = average_with_errors(found["short-range"], cells)
        told[f"means, {kind}"] = [means.image, means.sigma, means.code]
        coarse = Picture(means.image, means.sensor)
        told[f"shared out, {kind}"] = spread_errors(
            rng.random((*GRID, 3)), photos["coded"], coarse.image, cells
        )
    return told


def leaks() -> Any:
    rng = np.random.default_rng(5)
    told: dict[str, Any] = {}
    for kind, cells in CELLS.items():
        for goal, numbers in (("direct", {}), ("split", {"period": 4})):
            one = recipe(goal, CaptureScheme(), **numbers)
            shots = shots_of(one, cells, 6)
            lit_s = {shot.name: 30.0 for shot in one.shots}
            found = make_leak_answers(one, ShotMeans.of(one, shots, cells), lit_s, normalise="auto")
            ambient, mask = (
                DarkPhotoLight(level * rng.random((N, 3)), np.full((N, 3), 1e-6))
                for level in (0.02, 0.05)
            )
            told[f"{kind}, {goal}"] = [_leaks_of(answer, ambient, mask) for answer in found]
    return told


def _leaks_of(answer: LeakAnswer, ambient: DarkPhotoLight, mask: DarkPhotoLight) -> Any:
    both = DarkPhotoLight(ambient.light + mask.light, ambient.variance)
    less = both.less(mask)
    return [
        answer.image, answer.variance, answer.open, answer.closed, answer.ambient(ambient),
        answer.mask(mask), answer.both(ambient, mask), answer.most(both),
        answer.floor(ambient, mask), answer.floor(ambient), less.light, less.variance,
    ]  # fmt: skip


def slices() -> Any:
    told = {}
    for kind, cells in CELLS.items():
        for rows in ((1, 2), (3, 3)):
            one = recipe("transport", CaptureScheme(), rows=rows)
            rng = np.random.default_rng(7)
            shots: dict[str, ExposedShot] = {}
            for k, shot in enumerate(one.shots):
                primal, dual = one.programs[shot.program].pairs(np.zeros((0, N), np.bool_), None)  # type: ignore[arg-type]
                right, left = primal[[k]] + 0.01, dual[[k]] * rng.uniform(0.9, 1.0, N)
                factors = Factors(left, np.asarray(right, float), (left * right)[0], left[0])
                light = rng.uniform(0.1, 0.5, (*cells.frame, 3))
                none = np.zeros(cells.frame, np.bool_)
                shots[shot.name] = ComputedShot(light, 1e-3 * light, none, factors, {})
            found = solve_transport_slice(one, shots, cells)
            told[f"{kind}, {rows}"] = [
                found.entries, found.sigma, found.seen, found.lit, found.photos, found.uneven,
                found.rms_sigma, found.rms_error(0.9 * found.entries), draw_transport_slice(found,
                "T"),
            ]  # fmt: skip
    return told


def software() -> Any:
    told: dict[str, Any] = {}
    for kind, cells in CELLS.items():
        one = recipe("fraction", CaptureScheme(method="multi-image", codes=12), p=0.25)
        shots = shots_of(one, cells, 8)
        bits = np.random.default_rng(9).random((12, N)) < 0.5
        bits[:, 5] = False
        sums = sum_stack_shots(one, shots, bits, cells)
        told[kind] = {
            name: [s.light, s.variance, s.saturated, s.realised.coaxial, s.missed]
            for name, s in sums.items()
        }
        matrices = sum_stack_matrices(one, shots, bits)
        told[f"{kind}, matrices"] = {
            name: [m.realised.left, m.realised.right, m.realised.open_s, m.missed]
            for name, m in matrices.items()
        }
        coarse = average_shots(shots_of(recipe("direct", CaptureScheme()), cells, 10), cells).shots
        told[f"{kind}, told apart"] = {name: one.light for name, one in coarse.items()}
        ones = np.ones((1, N))
        share = compute_direct_share(
            Factors(ones, ones, np.linspace(0.01, 0.2, N), ones[0]),
            QuadWeights(np.full(cells.frame, 0.9), None), cells,
        )  # fmt: skip
        told[f"{kind}, direct share"] = share
    return told


def rasters() -> Any:
    told: dict[str, Any] = {}
    rng = np.random.default_rng(11)
    for name, place in {"turned": TURNED, "lens": LENS}.items():
        frame = (67, 101)
        view = FieldView(map_of(place, frame), 4.0 / 3.0)
        image = rng.random((*frame, 3)).astype(np.float32)
        known = rng.random(frame) < 0.97
        told[f"{name}, size"] = [view.quads(), view.size_px(10, 1000), view.size_px(200, 300)]
        for size in ((64, 48), (40, 30), (150, 113)):
            told[f"{name}, {size}"] = list(FieldSampler(view, size)(image, known))
    for name, cells in CELLS.items():
        thin = PixelSample.of(cells)
        told[f"thinned, {name}"] = [thin.step, thin.cell, thin.cells]
    large = PixelSample.of(msgspec.structs.replace(CELLS["lens"], frame=(400, 570)))
    told["thinned, large"] = [large.step, large.cell]
    for sign in (0.0, 1.0):
        wanted, realised = rng.random((2, *GRID)) - 0.5 * sign
        told[f"row, {sign}"] = MatrixRow("coded", wanted, realised).picture((2, 3))
    return told


MADE: dict[str, Callable[[], Any]] = {
    "combined": combined, "corrected": corrected, "smoothed": smoothed, "bars": bars,
    "leaks": leaks, "slices": slices, "software": software, "rasters": rasters,
}  # fmt: skip


@pytest.mark.parametrize("name", list(MADE))
def test_sums_are_what_they_were(name: str) -> None:
    alike(plain(MADE[name]()), kept_in(GOLDEN)[name], name)


if __name__ == "__main__":
    keep(GOLDEN, {name: plain(make()) for name, make in MADE.items()})
