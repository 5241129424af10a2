"""Light of displaced places through windows, against sums over points."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, DisplayConfig, PanelConfig, ScheduleConfig
from pdcd.panels.lattice import Lattice
from pdcd.planning.make import make_plan
from pdcd.probing.fine import Beams
from pdcd.probing.realised import collect_factors, compute_bench_factors
from pdcd.protocol.request import CaptureRequest
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.optics.products import PanelExposure
from pdcd.virtual.scene.displaced import DisplacedEffect
from pdcd.virtual.scene.scene import Scene
from tests.frame_logs import make_log

GRID = (3, 5)
FINE = 40
"""Points along either axis of a cell; all edges lie between them."""


def by_points(
    lattice: Lattice, moved: np.ndarray, mask: np.ndarray, light: np.ndarray, shift: int
) -> np.ndarray:
    """Share of each cell's points that are seen and lit, one refresh: patterns (L,) each."""
    (rows, cols), quarter = lattice.grid, lattice.window == "quarter"
    more = np.array([shift >> 1, shift & 1]) * 0.5 if quarter else np.zeros(2)
    inner = (np.arange(FINE) + 0.5) / FINE
    found = np.zeros(lattice.cells)
    for n in range(lattice.cells):
        if np.isnan(moved[n]).any():
            continue
        points = np.stack(np.meshgrid(n // cols + inner, n % cols + inner), axis=-1).reshape(-1, 2)
        seen = points + lattice.offset_cells + more
        cell = np.floor(seen).astype(int)
        place = points + moved[n]
        good = ((cell >= 0) & (cell < lattice.shape) & (place >= 0)).all(axis=1)
        good &= (place[:, 0] < rows) & (place[:, 1] < cols)
        if quarter:
            good &= ((seen - cell >= 0.25) & (seen - cell < 0.75)).all(axis=1)
        behind = np.floor(place + more).astype(int)[good] @ [lattice.shape[1], 1]
        found[n] = np.sum(mask[cell[good] @ [lattice.shape[1], 1]] * light[behind])
    return found / FINE**2


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.1, -0.2), (-0.15, 0.2)])
def test_fig11_displaced_light_is_the_sum_over_points(
    window: str, offset: tuple[float, float]
) -> None:
    rng = np.random.default_rng(1)
    lattice = Lattice(GRID, window, offset)
    moved = np.round(rng.uniform(-1.5, 1.5, (lattice.cells, 2)) * FINE) / FINE
    moved[3] = np.nan
    mask, light = rng.random((2, lattice.lattice_cells))
    expected = np.zeros(lattice.cells)
    masks, lights = [], []
    for shift in range(lattice.fields):
        expected += by_points(lattice, moved, mask, light, shift)
        field = np.zeros((lattice.fields, lattice.lattice_cells + 1))
        field[shift, :-1] = mask
        masks.append(field)
        lights.append(lattice.primal_field_values(light, shift))
    found = Beams(lattice, moved).seen_s(np.array(masks), np.array(lights))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert found[3] == 0.0
    assert found.max() > 0.05


@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_the_bench_of_pixels_and_that_of_cells_see_the_same(window: str) -> None:
    """Displacements of whole projector pixels: the camera's points then err nowhere."""
    grid, px = (4, 5), 16
    rng = np.random.default_rng(2)
    cells = grid[0] * grid[1]
    moved = np.stack([np.zeros(cells), rng.integers(-30, 30, cells) / px], axis=1)
    moved[7] = np.nan
    scene = Scene("moved", grid, (DisplacedEffect("direct", grid, rng.random(cells), moved),))
    size = (grid[1] * px, grid[0] * px)
    config = Config(
        projector=PanelConfig(size_px=size),
        mask=PanelConfig(size_px=size),
        camera=CameraConfig(quads_per_cell=px),
        schedule=ScheduleConfig(window=window),  # type: ignore[arg-type]
        display=DisplayConfig(),
    )
    plan = make_plan(CaptureRequest(goal="indirect", codes=12, smooth=False), config, grid)
    frames = plan.frames(next(s for s in plan.recipe.shots if s.name == "coded"))
    log = make_log(len(frames), start_ns=0, refresh_ns=10_000_000)
    end_ns = int(log.end_ns.max())
    whole = collect_factors(
        compute_bench_factors(
            frames, log, config.projector, config.mask, open_ns=0, close_ns=end_ns,
            displacement=scene.displacement,
        )
    )  # fmt: skip
    cells_light = scene.photo(whole.left, whole.right, whole.coaxial, whole.open_s, whole.displaced)
    optics = OpticalBench(config, scene, (grid[0] * px, grid[1] * px))
    quads = optics.photo(PanelExposure(frames, log, 0, end_ns))
    seen = quads.reshape(grid[0], px, grid[1], px, 3).mean(axis=(1, 3)).reshape(cells, 3)
    np.testing.assert_allclose(seen, cells_light, atol=1e-9)
    assert cells_light[7].max() == 0.0 < cells_light.max()
