"""Every pixel of the X screen against the planned code, and that against the lattice."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.x11 import X11Display
from pdcd.frames.frames import BLACK, WHITE, Frames
from pdcd.frames.lattice import Lattice
from pdcd.frames.patterns import compact, levels_of
from pdcd.presenter.cells import panel_edges
from tests import x11_rig
from tests.xserver import XServer


def random_frames(
    grid: tuple[int, int], window: str, rows: int, *, grey: bool = False, seed: int = 1
) -> Frames:
    """Rows of random patterns, with blacks and whites among them, under all sub-shifts."""
    rng = np.random.default_rng(seed)
    lattice = Lattice(grid, window)
    levels = rng.random((2, rows, lattice.lattice_cells))
    primal, dual = levels if grey else levels < 0.5
    index = np.arange(rows, dtype=np.int32)
    primal_index, dual_index = index.copy(), index[::-1].copy()
    primal_index[-2:], dual_index[-4:] = (BLACK, WHITE), (WHITE, BLACK, BLACK, WHITE)
    return Frames(
        primal_patterns=compact(primal),
        dual_patterns=compact(dual),
        primal_index=primal_index,
        dual_index=dual_index,
        shift=(index % lattice.fields).astype(np.uint8),
        code=index,
        guard=np.zeros(rows, dtype=np.bool_),
        grid=grid,
        lattice=lattice.shape,
        window=window,
    )


@contextmanager
def shown(
    folder: Path, server: XServer, panels: dict[str, Any] | None = None, **more: Any
) -> Iterator[X11Display]:
    config = x11_rig.config(folder, server, more=more)
    config = msgspec.structs.replace(
        config, display=msgspec.structs.replace(config.display, **(panels or {}))
    )
    display = x11_rig.display(config)
    display.connect()
    try:
        yield display
    finally:
        display.disconnect()


@pytest.fixture(scope="class")
def display(tmp_path_factory: pytest.TempPathFactory, x_quarter: XServer) -> Iterator[X11Display]:
    """A display for tests that change nothing but the frames."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
        patch.setenv("LP_NUM_THREADS", "1")
        with shown(tmp_path_factory.mktemp("panels"), x_quarter) as opened:
            yield opened


def mismatches(server: XServer, frames: Frames, row: int) -> int:
    """Wrong pixels on both panels, and lit ones beside them."""
    projector, mask, rest = x11_rig.panels(server)
    wrong = rest
    for found, size, is_mask in (
        (projector, server.projector_px, False),
        (mask, server.mask_px, True),
    ):
        wanted = x11_rig.planned(frames, row, size, mask=is_mask)
        wrong += int(np.count_nonzero(found != wanted[..., None]))
    return wrong


def only(frames: Frames, row: int) -> Frames:
    """One row of the frames, to be held."""
    parts = {
        name: getattr(frames, name)[row : row + 1]
        for name in ("primal_index", "dual_index", "shift", "code", "guard")
    }
    return Frames(
        **parts,
        primal_patterns=frames.primal_patterns,
        dual_patterns=frames.dual_patterns,
        grid=frames.grid,
        lattice=frames.lattice,
        window=frames.window,
    )


@pytest.mark.parametrize(
    ("layout", "window", "codes"), [("span", "whole", 20), ("windows", "quarter", 8)]
)
def test_full_size_panels_show_every_pixel(
    tmp_path: Path, x_full: XServer, layout: str, window: str, codes: int
) -> None:
    """In every layout and window; the last four rows have blacks and whites in them."""
    frames = random_frames((48, 64), window, codes)
    with shown(tmp_path, x_full, layout=layout) as display:
        for row in range(codes):
            display.show(only(frames, row))
            assert mismatches(x_full, frames, row) == 0, row
        display.black()
        assert not x11_rig.root_pixels(x_full).any()


class TestManyCells:
    """All on one display; starting one takes seconds."""

    @pytest.mark.parametrize("window", ["whole", "quarter"])
    @pytest.mark.parametrize("grid", [(48, 64), (7, 11), (37, 50), (1, 1)])
    def test_cells_that_do_not_divide_the_panels(
        self, display: X11Display, x_quarter: XServer, window: str, grid: tuple[int, int]
    ) -> None:
        frames = random_frames(grid, window, 8)
        for row in range(len(frames)):
            display.show(only(frames, row))
            assert mismatches(x_quarter, frames, row) == 0, row

    def test_grey_levels_are_rounded_to_8_bits(
        self, display: X11Display, x_quarter: XServer
    ) -> None:
        frames = random_frames((5, 9), "whole", 6, grey=True)
        for row in range(len(frames)):
            display.show(only(frames, row))
            assert mismatches(x_quarter, frames, row) == 0, row

    def test_played_rows_end_black(self, display: X11Display, x_quarter: XServer) -> None:
        display.load(random_frames((6, 8), "whole", 12))
        display.play(lambda *_: None, lambda: False)
        assert not x11_rig.root_pixels(x_quarter).any()


@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("order", ["GRB", "RGB"])
def test_24_planes_of_a_picture(
    tmp_path: Path, x_quarter: XServer, window: str, order: str
) -> None:
    """Row j of the frames is bit j % 8 of colour order[j // 8], under sub-shifts of its own."""
    frames = random_frames((12, 16), window, 24)
    panels = {"planes_per_refresh": 24, "plane_order": order}
    with shown(tmp_path, x_quarter, panels=panels) as display:
        display.show(frames)
        projector, mask, rest = x11_rig.panels(x_quarter)
    assert rest == 0
    for found, size, is_mask in (
        (projector, x_quarter.projector_px, False),
        (mask, x_quarter.mask_px, True),
    ):
        wanted = np.zeros((*size[::-1], 3), dtype=np.uint8)
        for j in range(24):
            lit = x11_rig.planned(frames, j, size, mask=is_mask) > 0
            wanted[..., "RGB".index(order[j // 8])] += lit.astype(np.uint8) << j % 8
        assert np.count_nonzero(found != wanted) == 0


def test_planes_are_logged_one_by_one_and_a_delayed_mask_comes_later(
    tmp_path: Path, x_quarter: XServer
) -> None:
    frames = random_frames((6, 8), "whole", 100)
    panels = {"planes_per_refresh": 24, "mask_delay_refreshes": 1}
    with shown(tmp_path, x_quarter, panels=panels) as display:
        display.load(frames)
        log = display.play(lambda *_: None, lambda: False)
    if log.missed.any():
        pytest.skip("THE MACHINE IS BUSY: a refresh was lost")
    assert len(log) == 124
    rows, black = np.arange(100), np.full(24, BLACK)
    np.testing.assert_array_equal(log.primal_shown, np.append(rows, black))
    np.testing.assert_array_equal(log.dual_shown, np.append(black, rows))
    assert log.mask_delay == 24
    assert np.median(np.diff(log.primal_ns)) == pytest.approx(1e9 / 60 / 24, rel=0.1)


@pytest.mark.parametrize(
    ("window", "shift"), [("whole", 0), *(("quarter", shift) for shift in range(4))]
)
def test_pixels_are_what_the_lattice_says(window: str, shift: int) -> None:
    """Cell means of both panels, and of their product, where quarters of cells divide the panel."""
    grid, size = (6, 5), (40, 24)
    frames, lattice = random_frames(grid, window, 8), Lattice(grid, window)
    row = shift if window == "quarter" else 0
    light = painted(frames, row, size, mask=False)
    opening = painted(frames, row, size, mask=True)
    primal = levels_of(frames.primal_patterns, frames.primal_index[row], lattice.lattice_cells)
    dual = levels_of(frames.dual_patterns, frames.dual_index[row], lattice.lattice_cells)
    fields = lattice.primal_field_values(primal, shift)
    windows = lattice.dual_field_values(dual, shift)
    np.testing.assert_allclose(cell_means(light, grid), fields.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(
        cell_means(opening, grid), windows.ravel() @ lattice.spread, atol=1e-12
    )
    coaxial = sum(
        o.area * lattice.seen(windows[o.dual_field][None], o)[0].ravel() * fields[o.primal_field]
        for o in lattice.overlaps
    )
    np.testing.assert_allclose(cell_means(light * opening, grid), coaxial, atol=1e-12)


def painted(frames: Frames, row: int, size: tuple[int, int], *, mask: bool) -> np.ndarray[Any, Any]:
    """A panel painted cell by cell from `panel_edges`, levels 0..1, (h, w)."""
    edges, shift = panel_edges(frames, size, mask=mask), int(frames.shift[row])
    patterns = frames.dual_patterns if mask else frames.primal_patterns
    index = frames.dual_index if mask else frames.primal_index
    levels = levels_of(patterns, int(index[row]), frames.lattice[0] * frames.lattice[1])
    image = np.zeros(size[::-1])
    for r in range(frames.lattice[0]):
        for c in range(frames.lattice[1]):
            (x0, x1), (y0, y1) = edges[shift & 1, c], edges[2 + (shift >> 1), r]
            image[y0:y1, x0:x1] = levels[r * frames.lattice[1] + c]
    return image


def cell_means(image: np.ndarray[Any, Any], grid: tuple[int, int]) -> np.ndarray[Any, Any]:
    rows, cols = grid
    height, width = image.shape
    blocks = image.reshape(rows, height // rows, cols, width // cols)
    return np.asarray(blocks.mean(axis=(1, 3))).ravel()
