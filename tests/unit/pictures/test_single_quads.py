"""Error bars at single quads that get their light by ways of their own, as in rough stone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import Config, PanelConfig
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.pictures.bars import make_pictures_with_errors
from pdcd.pictures.beside import estimate_quad_paths, map_neighbour_light
from pdcd.pictures.exposed import ComputedShot
from pdcd.pictures.learn import learn_paths
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.quad_samples import sample_quads
from pdcd.pictures.sigma import estimate_quad_shares, to_quad_errors
from pdcd.pictures.to_cells import unmix_cells
from pdcd.pictures.weights import weigh_cells
from pdcd.planning.make import plan_with_prior
from pdcd.probing.realised import collect_factors, compute_bench_factors
from pdcd.protocol.request import CaptureRequest
from pdcd.sensor.cells import CellMap
from tests.dense_camera import SETTLE_NS, DenseCamera, on_time

Floats = NDArray[np.float64]

GRID = (8, 10)
N = GRID[0] * GRID[1]
FRAME = (88, 110)
PX = (1000, 800)
NOISE = 0.02


@dataclass
class Photographed:
    """Stone, each point of which gets light from one place by chance, beside direct light: what the
    program makes of it, and what is true at each quad, by geometry alone."""

    dense: DenseCamera
    cells: CellMap
    shots: dict[str, ComputedShot]
    recipe: Any
    bars: PictureWithErrors
    true: Floats


@cache
def photographed() -> Photographed:
    map_ = make_placed_map(Placing(turn_deg=2.0, scale=1.05), (FRAME[1], FRAME[0]), PX, "camera")
    dense = DenseCamera(GRID, FRAME, map_, samples=3)
    cells = CellMap(grid=GRID, frame=FRAME, map=map_)
    rng = np.random.default_rng(5)
    shape = dense.inside.shape
    reach = np.where(rng.random(shape) < 0.5, 2.0, 4.5) * np.sqrt(
        -np.log(rng.uniform(1e-6, 1.0, shape))
    )
    angle = rng.uniform(0.0, 2.0 * np.pi, shape)
    apart = reach[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    ways = dense.points + apart / (GRID[1], GRID[0])
    inside = ((ways >= 0.0) & (ways < 1.0)).all(axis=-1)
    there = np.floor(ways * (GRID[1], GRID[0]))
    here = np.floor(dense.points * (GRID[1], GRID[0]))
    true = dense.quads((inside & (there != here).any(axis=-1)).astype(np.float64))

    given = {
        "goal": "indirect",
        "codes": 80,
        "white": False,
        "window": "quarter",
        "pilot": 16,
        "parts": 4,
    }
    plan = plan_with_prior(msgspec.convert(given, CaptureRequest), Config(), GRID)
    shots: dict[str, ComputedShot] = {}
    for shot in plan.recipe.shots:
        frames = plan.frames(shot)
        log = on_time(frames)
        close_ns = int(log.end_ns.max()) + SETTLE_NS
        projector, mask = PanelConfig(size_px=PX), PanelConfig(size_px=(1600, 1280))
        realised = collect_factors(compute_bench_factors(
            frames, log, projector, mask, open_ns=0, close_ns=close_ns, fine=True,
        ))  # fmt: skip
        light = dense.photo(frames, log, np.full(N, 3.0), np.zeros((N, N)), ways=ways)
        noise = NOISE * float(np.median(light[light > 0.0]))
        image = light[..., None] + noise * rng.standard_normal((*FRAME, 3))
        none = np.zeros(FRAME, np.bool_)
        shots[shot.name] = ComputedShot(image, np.full(image.shape, noise**2), none, realised, {})
    bits = np.stack([shots[name].realised.right.sum(axis=0) > 0.0 for name in plan.recipe.stack])
    single = [shots[name] for name in plan.recipe.stack]
    learned = learn_paths(GRID, [s.realised for s in single], bits, 80, unmix_cells(single, cells))
    record: Any = SimpleNamespace(smooth=True, normalise="auto", shots=(), stops=(), panels=None)
    bars = make_pictures_with_errors(record, plan.recipe, shots, learned, cells, lambda: None)[
        "indirect"
    ]
    return Photographed(dense, cells, shots, plan.recipe, bars, true)


def test_sigma_covers_quads_that_get_light_from_beside_by_chance() -> None:
    """Also in the middle of cells, where windows mistake nothing and codes alone err."""
    made = photographed()
    place = made.cells.centres * (GRID[1], GRID[0])
    off_middle = np.abs(place - np.floor(place) - 0.5).max(axis=-1)
    known = np.isfinite(made.bars.sigma).all(axis=-1)
    for quads in (known, known & (off_middle < 0.15), known & (off_middle > 0.35)):
        error = (made.bars.image - made.true[..., None])[quads]
        sigma = made.bars.sigma[quads]
        assert 0.915 < np.mean(np.abs(error) <= 1.96 * sigma) < 0.985
        assert 0.85 < np.sqrt(np.mean(sigma**2) / np.mean(error**2)) < 1.6


def test_windows_mistake_nothing_in_the_middle_of_cells_and_most_at_corners() -> None:
    """A code cell that is moved by half a cell has half of another cell, and at corners three
    quarters; a quarter, a half and a quarter of the quads see these, 7/16 on average."""
    made = photographed()
    coded = next(photo for photo in made.recipe.photos if photo.name == "coded")
    places = map_neighbour_light(weigh_cells(coded, made.shots, "auto"), made.cells)
    at = made.cells.centres * (GRID[1], GRID[0])
    quarter = np.abs(at - np.floor(at) - 0.5) - 0.25  # below 0: in the middle along an axis
    within = made.cells.known & (np.abs(quarter) > 0.08).all(axis=-1)
    inner = within & ((at > 1.0) & (at < (GRID[1] - 1, GRID[0] - 1))).all(axis=-1)
    for outside, share in ((0, 0.0), (1, 0.5), (2, 0.75)):
        here = inner & ((quarter > 0.0).sum(axis=-1) == outside)
        np.testing.assert_allclose(places[here], share / (7.0 / 16.0), atol=0.02)


@pytest.mark.parametrize("count", [4, 16])
def test_ways_of_light_are_told_by_photos_of_single_codes(count: int) -> None:
    """Nine points of a quad get a light of 1/9 each from a cell of its own, as long as that is lit;
    what lies beside the field sends nothing. Light that all quads of a cell get alike is no such
    way, nor is direct light."""
    made = photographed()
    single = [made.shots[name] for name in made.recipe.stack[:count]]
    ways = estimate_quad_paths(single, sample_quads(single, made.cells, within=True))
    sent = float(np.mean(made.true[made.cells.known]))
    assert np.sqrt(np.mean(ways)) == pytest.approx(np.sqrt(sent / 9.0), rel=0.15)
    lit = [shot.realised.left.mean(axis=1) @ shot.realised.right for shot in single]
    rng = np.random.default_rng(1)
    albedo, paths = rng.uniform(0.5, 1.0, FRAME), rng.uniform(0.0, 0.02, (N, N))
    smooth = []
    for shot, light in zip(single, lit, strict=True):
        image = albedo * made.cells.spread(3.0 * light + paths @ light)
        smooth.append(ComputedShot(
            np.repeat(image[..., None], 3, axis=2), np.zeros((*FRAME, 3)), shot.saturated,
            shot.realised, {},
        ))  # fmt: skip
    none = estimate_quad_paths(smooth, sample_quads(smooth, made.cells, within=True))
    assert np.sqrt(np.mean(none)) < 0.1 * np.sqrt(np.mean(ways))


def test_what_single_quads_err_by_is_told_by_parts_without_noise_and_their_cell() -> None:
    """Errors of cells by 10 %, of quads by 5 % beside, noise of 3 %; four parts, so a half of it
    is left of their mean. Light differs from quad to quad, and is none in some cells."""
    cells = CellMap(grid=GRID, frame=FRAME, map=photographed().dense.map)
    rng = np.random.default_rng(2)
    blank = np.zeros((*FRAME, 3))
    picked = sample_quads(
        [
            ComputedShot(
                blank, blank, blank[..., 0] > 0.0, photographed().shots["coded-1"].realised, {}
            )
        ],
        cells,
    )
    texture = rng.uniform(0.5, 1.0, (picked.cell.size, 1)) * (picked.cell[:, None] > 20)
    count = picked.cell.size
    for quads in (0.05, 0.0):
        parts = []
        for _ in range(4):
            of_cells = 1.0 + 0.1 * rng.standard_normal(N)[picked.cell, None]
            light = texture * (of_cells + quads * rng.standard_normal((count, 3)))
            parts.append(light + 0.03 * rng.standard_normal((count, 3)))
        images = np.ones((*GRID, 3)) * (np.arange(N).reshape(*GRID, 1) > 20)
        noise = [np.full((count, 3), 0.03**2)] * 4
        share = estimate_quad_shares(parts, noise, picked)
        found = to_quad_errors(share / len(parts), images).reshape(N, 3)
        assert np.isfinite(found).all() and not found[:20].any()
        here = texture[picked.cell > 40]  # of errors over light the mean square counts
        true = 0.5 * quads * np.sqrt(np.mean(here**2)) / np.mean(here)
        assert np.sqrt(np.mean(found[40:] ** 2)) == pytest.approx(true, rel=0.1, abs=0.004)
