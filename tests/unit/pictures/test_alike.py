"""What all parts of a photo get wrong alike, in its error bars."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from pdcd.bench.tables import Config
from pdcd.panels.frames import FrameLog, Frames
from pdcd.pictures.bars import add_known_errors, combine_picture_errors, with_beside_light
from pdcd.pictures.beside import USUAL, NeighbourError, estimate_neighbour_errors
from pdcd.pictures.exposed import ComputedShot, ExposedShot
from pdcd.pictures.learn import PilotFindings, _beside
from pdcd.pictures.picture import Picture
from pdcd.pictures.sigma import compute_neighbour_weight
from pdcd.pictures.to_cells import average_with_errors
from pdcd.pictures.weights import weigh_cells
from pdcd.planning.make import plan_with_prior
from pdcd.planning.plan import Plan
from pdcd.probing.realised import collect_factors, compute_bench_factors
from pdcd.protocol.request import CaptureRequest
from pdcd.sensor.cells import CellMap
from tests.dense_camera import SETTLE_NS, on_time

GRID = (6, 8)
N = 48
NONE = scipy.sparse.csr_array((N, N))


def plan_of(**fields: Any) -> Plan:
    return plan_with_prior(CaptureRequest(**{"codes": 16, **fields}), Config(), GRID)


def matrix_of(plan: Plan, frames: Frames, log: FrameLog) -> Any:
    return collect_factors(
        compute_bench_factors(
            frames, log, Config().projector, Config().mask,
            open_ns=0, close_ns=int(log.end_ns.max()) + SETTLE_NS,
        )
    )  # fmt: skip


def shots_of(plan: Plan) -> dict[str, ExposedShot]:
    """What the panels did; of the light it is only asked how much there is."""
    shots: dict[str, ExposedShot] = {}
    for shot in plan.recipe.shots:
        frames = plan.frames(shot)
        light, dark = np.ones((*GRID, 3)), np.zeros(GRID, np.bool_)
        realised = matrix_of(plan, frames, on_time(frames))
        shots[shot.name] = ComputedShot(light, light, dark, realised, {})
    return shots


def photos_of(plan: Plan, level: float = 1.0) -> dict[str, Picture]:
    image = np.full((*GRID, 3), level)
    return {photo.name: Picture(image, 0.01 * image) for photo in plan.recipe.photos}


def errors(plan: Plan, learned: PilotFindings | None = None) -> dict[str, NeighbourError]:
    cells, shots = CellMap.block(GRID, GRID), shots_of(plan)
    each = [weigh_cells(photo, shots, "auto") for photo in plan.recipe.photos]
    weighed = [(one, weight) for one in each if (weight := compute_neighbour_weight(one, GRID))]
    return estimate_neighbour_errors(weighed, photos_of(plan, 0.7), [], {}, learned, cells)


def told(near: float) -> PilotFindings:
    return PilotFindings(NONE, (NONE, NONE, NONE), None, 0.0, np.full((N, 3), near))


def test_quarter_windows_lack_light_from_beside_and_whole_ones_do_not() -> None:
    """A quarter window's code cell reaches a quarter of a cell beyond it: 3/16 of a cell beside two
    of its edges and 1/16 at the corner, 7/16 in all, and as much of the cell itself is let in."""
    plan = plan_of(goal="indirect", window="quarter")
    found = errors(plan, told(0.05))
    assert set(found) == {"coded"}
    np.testing.assert_array_equal(found["coded"].of_quads, found["coded"].even)
    np.testing.assert_allclose(found["coded"].even, 1.3 * np.hypot(7, 7) / 16 * 0.05, rtol=0.1)
    unknown = errors(plan)["coded"].even
    np.testing.assert_allclose(unknown, 1.3 * np.hypot(7, 7) / 16 * USUAL * 0.7, rtol=0.1)
    assert not errors(plan_of(goal="indirect", window="whole"), told(0.05))


def test_pictures_have_errors_as_they_are_made_of_photos() -> None:
    plan = plan_of(goal="direct", window="quarter")
    error = {"coded": np.full((*GRID, 3), 0.2)}
    pictures = combine_picture_errors(plan.recipe, photos_of(plan), error)
    assert set(pictures) == set(plan.recipe.pictures)
    np.testing.assert_array_equal(pictures["direct"], error["coded"])
    np.testing.assert_array_equal(pictures["indirect"], error["coded"])
    assert not pictures["white"].any()
    assert combine_picture_errors(plan.recipe, photos_of(plan), {}) == {}


def test_light_from_right_beside_is_in_the_bars_of_one_exposure() -> None:
    """Beside the noise; the quads of a cell have it in proportion to their light, which is 0.7 on
    average, and the mean of a cell has it, too."""
    plan = plan_of(goal="indirect", window="quarter")
    cells = CellMap.block(GRID, (2 * GRID[0], GRID[1]))
    image = np.full((*cells.frame, 3), 0.35)
    image[::2] = 1.05
    photos = {p.name: Picture(image, np.full(image.shape, 0.003)) for p in plan.recipe.photos}
    whole = {name: Picture(image, np.full(image.shape, 0.003)) for name in plan.recipe.pictures}
    alone = add_known_errors(plan.recipe, whole)
    found = with_beside_light(alone, plan.recipe, shots_of(plan), photos, {}, told(0.05), cells)
    error = float(errors(plan, told(0.05))["coded"].even.flat[0])
    np.testing.assert_allclose(found["indirect"].code[1::2], 0.5 * error, rtol=1e-6)
    np.testing.assert_allclose(
        found["indirect"].sigma[::2], np.hypot(0.003, 1.5 * error), rtol=1e-6
    )
    np.testing.assert_allclose(average_with_errors(found["indirect"], cells).code, error, rtol=1e-6)
    assert not found["white"].code.any()


def test_known_paths_from_beside_count_as_light_from_there() -> None:
    cells = np.arange(N).reshape(GRID)
    paths = scipy.sparse.lil_array((N, N))
    here = cells[2, 3]
    for row, col, light in ((2, 4, 0.3), (1, 2, 0.5), (2, 5, 7.0), (2, 3, 7.0), (3, 3, -1.0)):
        paths[here, cells[row, col]] = light
    paths[cells[0, 7], cells[1, 0]] = 7.0  # next to each other in number only
    one = scipy.sparse.csr_array(paths)
    found = _beside((one, NONE, one), GRID)
    wanted = np.zeros((N, 3))
    wanted[here] = 0.1, 0.0, 0.1
    np.testing.assert_allclose(found, wanted)
