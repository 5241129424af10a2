"""Photos at the camera's own quads against light that was worked out point by point."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from pdcd.bench.tables import Config, PanelConfig
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.pictures.exposed import ComputedShot
from pdcd.pictures.photos import make_corrected_photos
from pdcd.pictures.picture import Picture
from pdcd.planning.make import plan_with_prior
from pdcd.planning.plan import Plan
from pdcd.probing.realised import collect_factors, compute_bench_factors
from pdcd.protocol.request import CaptureRequest
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName
from tests.dense_camera import SETTLE_NS, DenseCamera, on_time
from tests.sampled import sampled

Floats = NDArray[np.float64]

GRID = (6, 8)
CELLS = GRID[0] * GRID[1]
FRAME = (43, 59)
PROJECTOR_PX = (1024, 768)
NORMALISES: tuple[NormaliseName, ...] = ("scalar", "row")

PLACES = {
    "shifted": Placing(offset_px=(11.0, 7.0)),
    "turned": Placing(turn_deg=7.0, scale=0.85, offset_px=(20.0, -13.0)),
    "larger": Placing(turn_deg=7.0, scale=1.3),
    "mirrored": Placing(flip="horizontal", offset_px=(31.0, 8.0), scale=0.9),
    "upside-down": Placing(turn_deg=180.0, scale=1.3),
    "portrait": Placing(turn_deg=90.0, scale=0.8),
    "lens": Placing(turn_deg=-2.0, scale=0.9, radial=(0.03, -0.01), tangential=(0.004, 0.002)),
}


def camera(place: Placing, frame: tuple[int, int] = FRAME, **more: Any) -> DenseCamera:
    map_ = make_placed_map(place, (frame[1], frame[0]), PROJECTOR_PX, "camera")
    return DenseCamera(GRID, frame, map_, **more)


def cells_of(dense: DenseCamera) -> CellMap:
    return CellMap(grid=dense.grid, frame=dense.frame, map=dense.map, blur_quads=dense.blur_quads)


def flat() -> tuple[Floats, Floats]:
    """Direct light and transport without a diagonal, alike for all cells: indirect light of 1."""
    transport = np.full((CELLS, CELLS), 1.0 / (CELLS - 1))
    np.fill_diagonal(transport, 0.0)
    return np.full(CELLS, 0.7), transport


def plan_of(**fields: Any) -> Plan:
    given = {"goal": "indirect", "codes": 16, "white": False, **fields}
    return plan_with_prior(msgspec.convert(given, CaptureRequest), Config(), GRID)


def photos_of(
    plan: Plan,
    dense: DenseCamera,
    scene: tuple[Floats, Floats],
    *,
    texture: Floats | None = None,
    mask: PanelConfig | None = None,
    shift_s: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0),
    normalise: NormaliseName = "auto",
    smooth: bool = False,
    cells: CellMap | None = None,
) -> dict[str, Picture]:
    """All photos of a plan, decoded, without noise."""
    mask = mask or PanelConfig(size_px=(1600, 1200))
    shots = {}
    for shot in plan.recipe.shots:
        frames = plan.frames(shot)
        log = on_time(frames, shift_s)
        close_ns = int(log.end_ns.max()) + SETTLE_NS
        realised = collect_factors(
            compute_bench_factors(
                frames,
                log,
                PanelConfig(size_px=PROJECTOR_PX),
                mask,
                open_ns=0,
                close_ns=close_ns,
                fine=True,
            )
        )
        width, height = PROJECTOR_PX
        light = dense.photo(
            frames,
            log,
            *scene,
            texture=texture,
            tau_s=mask.rise_s,
            leak=1.0 / mask.contrast if mask.contrast else 0.0,
            offset_cells=(
                mask.offset_px[1] * GRID[0] / height,
                mask.offset_px[0] * GRID[1] / width,
            ),
        )
        image = np.repeat(light[..., None], 3, axis=2)
        none = np.zeros(dense.frame, np.bool_)
        shots[shot.name] = ComputedShot(image, np.full(image.shape, 1e-6), none, realised, {})
    return make_corrected_photos(
        plan.recipe, shots, None, cells or cells_of(dense), normalise=normalise, smooth=smooth
    )


def residual(picture: Picture, truth: float | Floats = 1.0) -> Floats:
    """Relative error of the quads that are known."""
    known = np.isfinite(picture.sigma[..., 0])
    assert known.any()
    return np.asarray((picture.image[..., 0] / truth - 1.0)[known])


def at_cell_pitch(picture: Picture, dense: DenseCamera, parts: int = 4) -> Floats:
    """Mean light of all quads at the same place within their cells, over the mean of all."""
    known = np.isfinite(picture.sigma[..., 0])
    place = dense.map.centres() * (GRID[1], GRID[0])
    at = np.floor((place - np.floor(place)) * parts).astype(np.int64)[known]
    folded = at[:, 1] * parts + at[:, 0]
    image = picture.image[..., 0][known]
    count = np.bincount(folded, minlength=parts**2)
    sums = np.bincount(folded, image, minlength=parts**2)
    return np.asarray(sums[count > 0] / count[count > 0] / image.mean() - 1.0)


@pytest.mark.parametrize("place", sampled(["shifted", "turned", "portrait", "lens"], 3))
def test_a_flat_scene_is_flat(place: str) -> None:
    """Under quarter windows that were open unequally long, on a slow mask: windows differ by up to
    a third, and nothing of it is left."""
    _, transport = flat()
    dense = camera(PLACES[place], samples=5)
    photos = {
        normalise: photos_of(
            plan_of(window="quarter"),
            dense,
            (np.zeros(CELLS), transport),
            mask=PanelConfig(size_px=(1600, 1200), rise_s=0.002, fall_s=0.002),
            shift_s=(0.004, 0.0, 0.001, 0.0),
            normalise=normalise,
        )["coded"]
        for normalise in NORMALISES
    }
    assert np.abs(at_cell_pitch(photos["scalar"], dense)).max() < 5e-3
    by_row = np.abs(residual(photos["row"]))
    assert np.quantile(by_row, 0.3) < 1e-7  # quads within one window
    assert np.sqrt(np.mean(by_row**2)) < 1e-2  # those on an edge, as far as samples go


@pytest.mark.parametrize("place", sampled(["turned", "shifted"], 2))
def test_whole_windows_are_divided_by_what_quads_saw_of_them(place: str) -> None:
    """Random codes leave cells open unequally often; a mask out of register moves their edges."""
    _, transport = flat()
    photos = photos_of(
        plan_of(window="whole", family="bernoulli"),
        camera(PLACES[place], samples=8),
        (np.zeros(CELLS), transport),
        mask=PanelConfig(size_px=(1600, 1200), offset_px=(41.0, -17.0)),
        normalise="row",
    )
    error = np.abs(residual(photos["coded"]))
    assert np.quantile(error, 0.3) < 1e-9
    assert np.quantile(error, 0.9) < 2e-2  # the others see little beside the dark, by few samples


@pytest.mark.parametrize("blur_quads", [0.0, 1.5])
def test_blur_is_known(blur_quads: float) -> None:
    """Also at the border of the field, where it brings in the dark."""
    _, transport = flat()
    photos = photos_of(
        plan_of(window="quarter"),
        camera(PLACES["larger"], blur_quads=blur_quads),
        (np.zeros(CELLS), transport),
        shift_s=(0.004, 0.0, 0.0, 0.0),
        normalise="row",
    )
    assert np.sqrt(np.mean(residual(photos["coded"]) ** 2)) < 1e-2


@pytest.mark.parametrize("place", sampled(["turned", "mirrored"], 2))
def test_textured_scenes_are_as_right_as_on_an_aligned_camera(place: str) -> None:
    """Direct light, mutual light that falls off with distance, texture much finer than cells."""
    rng = np.random.default_rng(3)
    row, col = np.divmod(np.arange(CELLS), GRID[1])
    near = 1.0 / (1.0 + (row[:, None] - row) ** 2 + (col[:, None] - col) ** 2)
    np.fill_diagonal(near, 0.0)
    transport = near * rng.uniform(0.7, 1.3, (CELLS, 1))
    scene = rng.uniform(0.2, 1.0, CELLS), transport
    plan = plan_of(window="quarter", codes=32)
    errors = []
    for dense in (camera(Placing(), frame=GRID, samples=24), camera(PLACES[place])):
        x, y = dense.points[..., 0], dense.points[..., 1]
        texture = 1.0 + 0.5 * np.sign(np.sin(190.0 * x) * np.sin(140.0 * y))
        photo = photos_of(plan, dense, scene, texture=texture, smooth=True)["coded"]
        truth = dense.quads(texture * transport.sum(axis=1)[dense.cell])
        known = np.isfinite(photo.sigma[..., 0])
        error = (photo.image[..., 0] - truth)[known]
        errors.append(np.sqrt(np.mean(error**2) / np.mean(truth[known] ** 2)))
    assert errors[1] < 2.0 * errors[0]


def test_one_quad_a_cell_is_as_without_a_map() -> None:
    """But for rounding: what each quad saw is the mean over its cell."""
    dense = camera(Placing(), frame=GRID, samples=24)
    plan = plan_of(window="quarter", goal="direct", white=True)
    mask = PanelConfig(size_px=(1600, 1200), rise_s=0.002, fall_s=0.001, contrast=300.0)
    for normalise in NORMALISES:
        found = {}
        for cells in (cells_of(dense), CellMap.block(GRID, GRID)):
            photos = photos_of(
                plan, dense, flat(), mask=mask, normalise=normalise, smooth=True, cells=cells
            )
            found[cells.map is None] = photos
        for name, photo in found[True].items():
            np.testing.assert_allclose(found[False][name].image, photo.image, rtol=1e-13)
            np.testing.assert_allclose(found[False][name].sigma, photo.sigma, rtol=1e-13)
