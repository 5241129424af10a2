"""What is wanted of places between the centres of cells, and of quads whose blur leaves the field,
against light that is added up point by point."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig, PanelConfig
from pdcd.panels.placing import Placing
from pdcd.pictures.truth import compute_true_answer
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.scene.effects import DenseEffect, make_direct_effects
from pdcd.virtual.scene.scene import Scene
from tests.unit.virtual.optics.test_bench import GRID, PX, config_of

Floats = NDArray[np.float64]

N = 12
FRAME = (11, 15)
"""Rows and columns of quads: no whole number to a cell."""


def bench_of(
    scene: Scene, field_px: tuple[int, int, int, int] | None = None, **camera: Any
) -> OpticalBench:
    projector = PanelConfig(size_px=PX, field_px=field_px)
    given = CameraConfig(frame_quads=(FRAME[1], FRAME[0]), **camera)
    return OpticalBench(config_of(projector=projector, camera=given), scene, FRAME)


def scene_of(rng: np.random.Generator) -> tuple[Scene, Floats]:
    """A textured scene, and its transport beside direct light, of the same in all channels; near
    light and what wanders within a cell are strong in it."""
    transport = rng.random((N, N)) + 3.0 * np.eye(N)
    direct = make_direct_effects(rng.random((N, 3)))
    texture = 0.2 + rng.random((9, 12, 3))
    return Scene("s", GRID, (*direct, DenseEffect("all", transport)), texture=texture), transport


def reflected(y: Floats, cells: Floats, texture: Floats) -> Floats:
    """What cells (N, 3) send from a point of the field."""
    rows, cols = GRID
    height, width = texture.shape[:2]
    means = texture.reshape(rows, height // rows, cols, width // cols, 3).mean(axis=(1, 3))
    smooth = cells.reshape(rows, cols, 3) / means
    found = np.zeros(3)
    for r in range(-1, rows + 1):
        for c in range(-1, cols + 1):
            near = max(0.0, 1.0 - abs(y[1] * rows - 0.5 - r)) * max(
                0.0, 1.0 - abs(y[0] * cols - 0.5 - c)
            )
            found += near * smooth[min(max(r, 0), rows - 1), min(max(c, 0), cols - 1)]
    return np.asarray(found * texture[int(y[1] * height), int(y[0] * width)])


FIELD = (6, 3, 36, 30)
"""The part of the projector's picture, in its pixels, that codes fill."""


def codes_lit(grid: tuple[int, int], field: tuple[int, int, int, int]) -> Floats:
    """Share of each of the scene's cells that each cell of codes lights, (cells, N), by pixels."""
    (rows, cols), (left, top, width, height) = grid, field
    found = np.zeros((rows * cols, N))
    for y, x in np.ndindex(height, width):
        own = int((y + 0.5) * rows / height) * cols + int((x + 0.5) * cols / width)
        there = (top + y) * GRID[0] // PX[1] * GRID[1] + (left + x) * GRID[1] // PX[0]
        found[own, there] += N / (PX[0] * PX[1])
    return found


def added_up(
    bench: OpticalBench, transport: Floats, weights: Floats, grid: tuple[int, int],
    field: tuple[int, int, int, int],
) -> Floats:  # fmt: skip
    """What is wanted by weights (cells, cells) of codes of this grid on a part of the picture."""
    scene, samples = bench.scene, bench._setting.samples
    direct = np.stack([e.diagonal()[:, None] * e.tint for e in scene.effects[:3]]).sum(axis=0)
    (rows, cols), lit = grid, codes_lit(grid, field)
    wanted = np.zeros((*FRAME, 3))
    for row, col in np.ndindex(*FRAME):
        for a, b in np.ndindex(samples, samples):
            y = np.array(
                [(col + (b + 0.5) / samples) / FRAME[1], (row + (a + 0.5) / samples) / FRAME[0]]
            )
            u = (y * PX - field[:2]) / field[2:]
            if not ((u >= 0.0) & (u < 1.0)).all():
                continue  # the mask is closed there
            own = int(u[1] * rows) * cols + int(u[0] * cols)
            sent = weights[own, own] * direct + (transport @ (weights[own] @ lit))[:, None]
            if scene.texture is None:
                seen = sent[int(y[1] * GRID[0]) * GRID[1] + int(y[0] * GRID[1])]
            else:
                seen = reflected(y, sent, scene.texture)
            wanted[row, col] += seen / samples**2
    return wanted


LIGHT, REGION = np.random.default_rng(5).random((2, *GRID))
WARP = np.random.default_rng(6).permutation(N).reshape(GRID)
MEANT: dict[str, tuple[Target, Floats]] = {
    "indirect": (Target(Goal(name="indirect"), GRID), 1.0 - np.eye(N)),
    "direct": (Target(Goal(name="direct"), GRID), np.eye(N)),
    "warped": (
        Target(Goal(name="warped"), GRID, {"warp": WARP.ravel().astype(np.float64)}),
        np.eye(N)[WARP.ravel()],
    ),
    "blocked": (
        Target(Goal(name="blocked"), GRID, {"region_a": REGION.ravel(), "region_b": LIGHT.ravel()}),
        1.0 - np.outer(REGION, LIGHT),
    ),
    "indirect, lit": (
        Target(Goal(name="indirect"), GRID, {"illumination": LIGHT.ravel()}),
        (1.0 - np.eye(N)) * LIGHT.ravel(),
    ),
}


@pytest.mark.parametrize("name", MEANT)
def test_what_is_wanted_at_a_place_is_the_row_of_the_cell_it_lies_in(name: str) -> None:
    """Also where such a place has the light of the next cell's centre: what that cell's projector
    cell sends there is indirect light, and lies in a photo of it."""
    scene, transport = scene_of(np.random.default_rng(3))
    bench = bench_of(scene)
    target, weights = MEANT[name]
    recipe = make_recipe(target, CaptureScheme())
    found = bench.wanted(lambda part: compute_true_answer(part, recipe), recipe.wanted)
    wanted = added_up(bench, transport, weights, GRID, (0, 0, *PX))
    np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-9)  # shares in single precision
    # Cell by cell, what is wanted of the next cell counts as wanted here.
    before = bench.wanted(lambda part: compute_true_answer(part, recipe))
    assert float(np.abs(before - wanted).max()) > 0.03 * float(wanted.max())


@pytest.mark.parametrize(
    ("name", "grid", "textured"),
    [("indirect", (5, 6), True), ("direct", GRID, True), ("indirect, lit", (5, 6), False)],
)
def test_codes_on_a_part_of_the_picture_mean_their_own_cells(
    name: str, grid: tuple[int, int], textured: bool
) -> None:
    """Whose borders lie anywhere in those of the scene."""
    scene, transport = scene_of(np.random.default_rng(3))
    if not textured:
        scene = Scene("s", GRID, scene.effects)
    bench = bench_of(scene, FIELD)
    cells = grid[0] * grid[1]
    light = np.random.default_rng(9).random(cells)
    weights = {
        "indirect": 1.0 - np.eye(cells), "direct": np.eye(cells),
        "indirect, lit": (1.0 - np.eye(cells)) * light,
    }[name]  # fmt: skip
    arrays = {"illumination": light} if "lit" in name else {}
    recipe = make_recipe(Target(Goal(name=name.split(",")[0]), grid, arrays), CaptureScheme())  # type: ignore[arg-type]
    found = bench.wanted(lambda part: compute_true_answer(part, recipe), recipe.wanted, grid=grid)
    wanted = added_up(bench, transport, weights, grid, FIELD)
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-8)
    inside = bench.inside_of(grid)
    assert 0 < inside.sum() < bench.inside.sum()


@pytest.mark.parametrize("place", [Placing(), Placing(scale=1.4, turn_deg=10.0)])
def test_a_flat_scene_stays_flat_where_the_blur_reaches_beyond_the_field(place: Placing) -> None:
    """Beyond it is dark, whether the frame ends there or not."""
    cells = np.ones((N, 3))
    scene = Scene("flat", GRID, make_direct_effects(cells))
    bench = bench_of(scene, blur_quads=1.2, place=place)
    found = bench.wanted(lambda part: part.white())
    inside, share = bench.inside, bench.share
    assert share is not None and inside.any()
    np.testing.assert_allclose(found[inside], 1.0, atol=0.02)
    assert 0.2 < share[inside].min() < 0.6 and share.max() > 0.9


def test_a_frame_that_ends_within_the_field_goes_on_beyond_its_edge() -> None:
    scene = Scene("flat", GRID, make_direct_effects(np.ones((N, 3))))
    bench = bench_of(scene, blur_quads=1.2, place=Placing(scale=0.5))
    assert bench.share is not None
    np.testing.assert_allclose(bench.share, 1.0, atol=1e-12)
