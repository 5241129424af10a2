"""The probing matrix out of pixels: against a dense sum, against the frame log, and with faults.

The oracle spreads both panels over one grid so fine that every cell and every pixel of either panel
is a whole number of points, and adds up refresh by refresh.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from pdcd.bench.tables import PanelConfig
from pdcd.codes.make import make_codes
from pdcd.errors import ConfigError
from pdcd.panels.frames import BLACK, WHITE, FrameLog, Frames
from pdcd.panels.patterns import read_pattern_levels
from pdcd.panels.pixels import ShownPictures
from pdcd.panels.schedule import build_frames
from pdcd.probing.pixel_matrix import compute_pixel_factors
from pdcd.probing.realised import Factors, collect_factors, compute_bench_factors
from pdcd.virtual.scene.matrix import split_into_effects
from pdcd.virtual.scene.scene import Scene
from tests import bench_rig
from tests.frame_logs import make_log
from tests.panel_pixels import from_pictures

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

MS = 1_000_000
REFRESH_NS = 16 * MS


def log_of(count: int, *, lag_ns: int = 0) -> FrameLog:
    """Every refresh on time, the mask `lag_ns` behind the projector."""
    return make_log(count, refresh_ns=REFRESH_NS, late_ns=lag_ns)


def panel(width: int, height: int, **more: Any) -> PanelConfig:
    return PanelConfig(size_px=(width, height), **more)


def of_pixels(
    shown: ShownPictures,
    log: FrameLog,
    grid: tuple[int, int],
    *panels: PanelConfig,
    open_s: float = 10.0,
) -> Factors:
    close_ns = round(open_s * 1e9)
    return collect_factors(
        compute_pixel_factors(shown, log, *panels, grid=grid, open_ns=0, close_ns=close_ns)
    )


def spread(picture: Floats, rows: int, columns: int) -> Floats:
    """Repeat pixels to a finer grid of whole points."""
    return picture.repeat(rows // picture.shape[0], axis=0).repeat(
        columns // picture.shape[1], axis=1
    )


def dense(
    projector: list[Bytes],
    mask: list[Bytes],
    grid: tuple[int, int],
    overlap_s: float,
    next_s: float,
) -> Factors:
    """The sum over refreshes, point by point: each mask picture meets the projector picture of its
    own refresh for `overlap_s`, that of the next for `next_s`.
    """
    rows = math.lcm(grid[0], projector[0].shape[0], mask[0].shape[0])
    columns = math.lcm(grid[1], projector[0].shape[1], mask[0].shape[1])
    black = np.zeros_like(projector[0])

    def cells(points: Floats) -> Floats:
        blocks = points.reshape(grid[0], rows // grid[0], grid[1], columns // grid[1])
        return np.asarray(blocks.mean(axis=(1, 3))).ravel()

    n = grid[0] * grid[1]
    left, right, coaxial, opened = [np.zeros(n)], [np.zeros(n)], np.zeros(n), np.zeros(n)
    for m, i, after in zip(mask, projector, [*projector[1:], black], strict=True):
        window = spread(m / 255.0, rows, columns)
        light = spread((overlap_s * i + next_s * after) / 255.0, rows, columns)
        left.append(cells(window))
        right.append(cells(light))
        coaxial += cells(window * light)
        opened += cells(window) * (overlap_s + next_s)
    return Factors(np.array(left), np.array(right), coaxial, opened)


def same(found: Factors, wanted: Factors) -> None:
    np.testing.assert_allclose(found.dense(), wanted.dense(), rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.coaxial, wanted.coaxial, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.open_s, wanted.open_s, rtol=0, atol=1e-13)


SIDE = st.integers(1, 7)


@pytest.mark.long
@given(
    grid=st.tuples(SIDE, SIDE),
    projector_px=st.tuples(SIDE, SIDE),
    mask_px=st.tuples(SIDE, SIDE),
    lag_ms=st.integers(0, 16),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_pictures_on_panels_that_no_cell_divides(
    grid: tuple[int, int],
    projector_px: tuple[int, int],
    mask_px: tuple[int, int],
    lag_ms: int,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    projector = [rng.integers(0, 256, projector_px[::-1], dtype=np.uint8) for _ in range(4)]
    mask = [rng.integers(0, 256, mask_px[::-1], dtype=np.uint8) for _ in range(4)]
    found = of_pixels(
        from_pictures(projector, mask),
        log_of(4, lag_ns=lag_ms * MS),
        grid,
        panel(*projector_px),
        panel(*mask_px),
    )
    same(found, dense(projector, mask, grid, (16 - lag_ms) * 1e-3, lag_ms * 1e-3))


# Codes as they ought to be shown, on panels whose cells are whole numbers of pixels.

GRID = (6, 8)
PROJECTOR_PX, MASK_PX = (32, 24), (64, 48)  # 4 x 4 and 8 x 8 pixels a cell


def picture(frames: Frames, row: int, size_px: tuple[int, int], *, mask: bool) -> Bytes:
    """Pixels of one refresh, by asking each pixel's middle which code cell it lies in."""
    width, height = size_px
    index = int((frames.dual_index if mask else frames.primal_index)[row])
    if index in (BLACK, WHITE):
        return np.full((height, width), 255 * (index == WHITE), dtype=np.uint8)
    patterns = frames.dual_patterns if mask else frames.primal_patterns
    cells = read_pattern_levels(patterns, index, frames.lattice[0] * frames.lattice[1])
    levels = cells.reshape(frames.lattice)
    shift = int(frames.shift[row])
    down = ((np.arange(height) + 0.5) / height * frames.grid[0] + 0.5 * (shift >> 1))[:, None]
    right = ((np.arange(width) + 0.5) / width * frames.grid[1] + 0.5 * (shift & 1))[None, :]
    out = levels[down.astype(int), right.astype(int)]
    if mask and frames.window == "quarter":
        for place in (down % 1.0, right % 1.0):
            out = out * ((place >= 0.25) & (place < 0.75))
    return np.asarray(np.rint(255 * out), dtype=np.uint8)


def asked(window: str, count: int = 6) -> Frames:
    lattice = (GRID[0] + 1, GRID[1] + 1) if window == "quarter" else GRID
    codes = make_codes("balanced", lattice, count, dual="complement")
    return build_frames(bench_rig.pairs(codes), GRID, window=window, schedule="full", passes=1)


def shown(frames: Frames) -> tuple[list[Bytes], list[Bytes]]:
    rows = range(len(frames))
    return (
        [picture(frames, r, PROJECTOR_PX, mask=False) for r in rows],
        [picture(frames, r, MASK_PX, mask=True) for r in rows],
    )


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize(
    ("projector", "mask"),
    [
        ({}, {}),
        ({"contrast": 900.0}, {"contrast": 300.0, "skew_s": 0.003}),
        ({"rise_s": 1e-3}, {"rise_s": 4e-3, "fall_s": 7e-3, "contrast": 300.0}),
        ({"fall_s": 2e-3, "rise_s": 2e-3}, {"fall_s": 5e-3}),
    ],
)
def test_right_pixels_give_the_matrix_of_the_frame_log(
    window: str, projector: dict[str, Any], mask: dict[str, Any]
) -> None:
    frames = asked(window)
    log = log_of(len(frames), lag_ns=2 * MS)
    panels = panel(*PROJECTOR_PX, **projector), panel(*MASK_PX, **mask)
    close_ns = 5_000 * MS
    wanted = collect_factors(
        compute_bench_factors(frames, log, *panels, open_ns=0, close_ns=close_ns)
    )
    found = of_pixels(from_pictures(*shown(frames)), log, GRID, *panels, open_s=5.0)
    same(found, wanted)


def test_a_mask_out_of_place_gives_the_matrix_of_the_frame_log() -> None:
    """Whole windows; a quarter of a cell right, a fifth up: no pixel edges meet."""
    frames = asked("whole")
    log = log_of(len(frames))
    panels = panel(*PROJECTOR_PX), panel(*MASK_PX, offset_px=(1.0, -0.8), contrast=100.0)
    wanted = collect_factors(
        compute_bench_factors(frames, log, *panels, open_ns=0, close_ns=10_000 * MS)
    )
    same(of_pixels(from_pictures(*shown(frames)), log, GRID, *panels), wanted)


def test_an_exposure_that_is_cut_short_counts_what_was_lit_until_then() -> None:
    white = [np.full((2, 2), 255, dtype=np.uint8)] * 3
    panels = panel(2, 2), panel(2, 2)
    found = of_pixels(from_pictures(white, white), log_of(3), (1, 1), *panels, open_s=0.060)
    assert found.coaxial == pytest.approx(0.010, abs=1e-15)
    assert found.open_s == pytest.approx(0.010, abs=1e-15)


# Faults, each with a photo that can be worked out by hand.


def photo(projector: list[Bytes], mask: list[Bytes], transport: Floats) -> Floats:
    """Grey photo (N,) of a scene on GRID, for refreshes of 16 ms."""
    factors = of_pixels(
        from_pictures(projector, mask),
        log_of(len(mask)),
        GRID,
        panel(*PROJECTOR_PX),
        panel(*MASK_PX),
    )
    scene = Scene("test", GRID, split_into_effects(transport))
    return scene.photo(factors.left, factors.right, factors.coaxial, factors.open_s)[:, 0]


N = GRID[0] * GRID[1]
FLAT = np.eye(N)
"""Every cell returns all its light to itself."""
REFRESH_S = REFRESH_NS * 1e-9


def code(cells: list[int], size_px: tuple[int, int]) -> Bytes:
    """White in these cells."""
    levels = np.zeros(N, dtype=np.uint8)
    levels[cells] = 255
    columns, rows = size_px[0] // GRID[1], size_px[1] // GRID[0]
    return levels.reshape(GRID).repeat(rows, axis=0).repeat(columns, axis=1)


def test_one_wrong_pixel_costs_its_share_of_the_cell() -> None:
    right = code([20], PROJECTOR_PX), code([20], MASK_PX)
    dark = right[0].copy()
    dark[10, 18] = 0  # in cell 20 = row 2, column 4: rows 8..11, columns 16..19
    change = photo([dark], [right[1]], FLAT) - photo([right[0]], [right[1]], FLAT)
    wanted = np.zeros(N)
    wanted[20] = -REFRESH_S / 16.0  # one of 4 x 4 pixels
    np.testing.assert_allclose(change, wanted, atol=1e-15)
    hole = right[1].copy()
    hole[40, 3] = 85  # cell 40 = row 5, column 0, opened by a third in one of 8 x 8 pixels
    change = photo([code([40], PROJECTOR_PX)], [hole], FLAT)
    wanted = np.zeros(N)
    wanted[40] = REFRESH_S / 64.0 / 3.0
    np.testing.assert_allclose(change, wanted, atol=1e-15)


def test_pictures_that_do_not_fit_are_refused() -> None:
    small = np.zeros((2, 2), dtype=np.uint8)
    pictures = from_pictures([small], [small])
    with pytest.raises(ConfigError, match="1 pictures of the screen for 2 refreshes"):
        of_pixels(pictures, log_of(2), (1, 1), panel(2, 2), panel(2, 2))
    with pytest.raises(ConfigError, match="mask: pictures of"):
        of_pixels(pictures, log_of(1), (1, 1), panel(2, 2), panel(3, 2))


def one_refresh(projector: list[list[int]], mask: list[list[int]]) -> ShownPictures:
    return from_pictures([np.array(projector, np.uint8)], [np.array(mask, np.uint8)])


@pytest.mark.parametrize("defect", [{"scan_s": 0.001}, {"scan_s": -0.001}, {"blur_px": 0.5}])
@pytest.mark.parametrize("side", ["projector", "mask"])
def test_panels_of_which_pixels_do_not_tell_all_are_refused(
    side: str, defect: dict[str, Any]
) -> None:
    panels = {"projector": panel(2, 1), "mask": panel(2, 1), side: panel(2, 1, **defect)}
    pictures = one_refresh([[255, 0]], [[255, 0]])
    with pytest.raises(ConfigError, match="one after the other") as caught:
        of_pixels(pictures, log_of(1), (1, 2), panels["projector"], panels["mask"])
    assert caught.value.device == side


def test_pixels_are_shared_by_the_cells_they_lie_over() -> None:
    """Three pixels of the projector and two of the mask over four cells, one refresh.

    The projector's middle pixel covers the thirds of the field from 1/3 to 2/3, the mask's second
    one its right half: they meet from 1/2 to 2/3, which is the first two thirds of the third cell.
    """
    pictures = one_refresh([[0, 255, 0]], [[0, 255]])
    got = of_pixels(pictures, log_of(1), (1, 4), panel(3, 1), panel(2, 1))
    coaxial, opened = np.array([0, 0, 2 / 3, 0]), np.array([0, 0, 1, 1])
    np.testing.assert_allclose(got.coaxial, REFRESH_S * coaxial, atol=1e-15)
    np.testing.assert_allclose(got.open_s, REFRESH_S * opened, atol=1e-15)
    np.testing.assert_allclose(
        got.dense(), REFRESH_S * np.outer(opened, [0, 2 / 3, 2 / 3, 0]), atol=1e-15
    )


def test_levels_are_light_by_the_curve_of_their_panel() -> None:
    pictures = one_refresh([[51]], [[102]])
    plain, square = panel(1, 1), panel(1, 1, gamma=2.0)
    for panels, light, opened in (((square, plain), 0.04, 0.4), ((plain, square), 0.2, 0.16)):
        got = of_pixels(pictures, log_of(1), (1, 1), *panels)
        np.testing.assert_allclose(got.coaxial, [REFRESH_S * light * opened], rtol=1e-12)
        np.testing.assert_allclose(got.open_s, [REFRESH_S * opened], rtol=1e-12)
