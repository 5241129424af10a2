"""Every pixel of the X screen against the planned code, and what `draw` says of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.x11 import X11Display
from pdcd.frames.draw import draw, draw_planes
from pdcd.frames.frames import BLACK, Frames
from tests import x11_rig
from tests.panel_pixels import planned, random_frames
from tests.xserver import XServer


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
        for wanted in (
            planned(frames, row, size, mask=is_mask),
            draw(frames, size, row, mask=is_mask),
        ):
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
    ("layout", "window", "codes"), [("span", "whole", 6), ("windows", "quarter", 5)]
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
            lit = planned(frames, j, size, mask=is_mask) > 0
            wanted[..., "RGB".index(order[j // 8])] += lit.astype(np.uint8) << j % 8
        assert np.count_nonzero(found != wanted) == 0
        drawn = draw_planes(frames, size, range(24), mask=is_mask, order=order)
        np.testing.assert_array_equal(drawn, wanted)


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
