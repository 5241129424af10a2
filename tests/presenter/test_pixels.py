"""Every pixel of the X screen against the planned code, and what `draw` says of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.x11 import X11Display
from pdcd.bench.placed import panels_of
from pdcd.bench.tables import PanelConfig
from pdcd.errors import ConfigError
from pdcd.panels.draw import draw, draw_planes
from pdcd.panels.frames import BLACK, PIXEL_WINDOW, WHITE, Frames
from pdcd.panels.map import PanelView
from pdcd.panels.patterns import pack_bits
from pdcd.panels.pixels import PanelBox
from pdcd.panels.placing import Placing
from tests import lateness, x11_rig
from tests.panel_pixels import planned, random_frames
from tests.sampled import sampled
from tests.xserver import XServer

pytestmark = pytest.mark.whole

BENT = {
    "projector": Placing(
        flip="horizontal", turn_deg=-5.0, scale=1.2, offset_px=(2.5, -3.0), radial=(0.06, -0.02)
    ),
    "mask": Placing(
        turn_deg=184.0,
        scale=1.3,
        offset_px=(1.3, 0.7),
        radial=(-0.03, 0.0),
        tangential=(0.004, -0.003),
    ),
}
"""Mirrored, turned, distorted; both cover the field, and more."""
ODD: tuple[PanelBox, PanelBox] = ((3, 2, 251, 187), (257, 1, 397, 299))
"""Panels of odd sizes at odd places of the screen."""


@contextmanager
def shown(
    folder: Path,
    server: XServer,
    panels: dict[str, Any] | None = None,
    *,
    places: dict[str, Placing] | None = None,
    boxes: tuple[PanelBox, PanelBox] | None = None,
    **more: Any,
) -> Iterator[tuple[X11Display, Screen]]:
    """A display, and what its screen should be compared by."""
    sizes = server.projector_px, server.mask_px
    if boxes is not None:
        sizes = boxes[0][2:], boxes[1][2:]
        more["positions_px"] = [box[:2] for box in boxes]
    tables: dict[str, Any] = {
        role: PanelConfig(size_px=size, place=(places or {}).get(role, Placing()))
        for role, size in zip(("projector", "mask"), sizes, strict=True)
    }
    config = x11_rig.config(folder, server, more=more, **tables)
    config = msgspec.structs.replace(
        config, display=msgspec.structs.replace(config.display, **(panels or {}))
    )
    views = panels_of(config)
    display = x11_rig.display(config)
    display.connect()
    try:
        yield display, Screen(server, (views.projector, views.mask), boxes)
    finally:
        display.disconnect()


@dataclass(frozen=True)
class Screen:
    """What a server's screen holds, against what two panels must show."""

    server: XServer
    views: tuple[PanelView, PanelView]
    boxes: tuple[PanelBox, PanelBox] | None

    def mismatches(self, frames: Frames, row: int) -> int:
        """Wrong pixels on both panels, and lit ones beside them."""
        *panels, wrong = x11_rig.panels(self.server, self.boxes)
        for found, view in zip(panels, self.views, strict=True):
            for wanted in (planned(frames, row, view), draw(frames, view, row)):
                wrong += int(np.count_nonzero(found != wanted[..., None]))
        return wrong


@pytest.fixture(scope="class", params=["upright", "bent, odd sizes"])
def opened(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, x_quarter: XServer
) -> Iterator[tuple[X11Display, Screen]]:
    """A display for tests that change nothing but the frames."""
    more: dict[str, Any] = {} if request.param == "upright" else {"places": BENT, "boxes": ODD}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
        with shown(tmp_path_factory.mktemp("panels"), x_quarter, **more) as display:
            yield display


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


@pytest.mark.long
@pytest.mark.parametrize(
    ("layout", "window", "places"),
    [("span", "whole", None), ("windows", "quarter", BENT)],
)
def test_full_size_panels_show_every_pixel(
    tmp_path: Path,
    x_full: XServer,
    layout: str,
    window: str,
    places: dict[str, Placing] | None,
) -> None:
    """In every layout and window: a row in place, one moved both ways, and white."""
    frames = random_frames((48, 64), window, 8)
    with shown(tmp_path, x_full, places=places, layout=layout) as (display, screen):
        for row in (0, 3, 7):
            display.show(only(frames, row))
            assert screen.mismatches(frames, row) == 0, row
        display.black()
        assert not x11_rig.root_pixels(x_full).any()


class TestManyCells:
    """All on one display; starting one takes seconds."""

    @pytest.mark.parametrize("window", ["whole", "quarter"])
    @pytest.mark.parametrize(
        "grid",
        [(48, 64), (37, 50), (5, 130)]
        + [pytest.param(grid, marks=pytest.mark.long) for grid in ((7, 11), (1, 1))],
    )
    def test_cells_that_do_not_divide_the_panels(
        self, opened: tuple[X11Display, Screen], window: str, grid: tuple[int, int]
    ) -> None:
        display, screen = opened
        frames = random_frames(grid, window, 8)
        for row in range(len(frames)):
            display.show(only(frames, row))
            assert screen.mismatches(frames, row) == 0, row

    @pytest.mark.parametrize("window", sampled(["side-5/8", "side-3/4", "side-7/8"], 3))
    def test_windows_that_overlap(self, opened: tuple[X11Display, Screen], window: str) -> None:
        display, screen = opened
        frames = random_frames((7, 11), window, 8)
        for row in range(len(frames)):
            display.show(only(frames, row))
            assert screen.mismatches(frames, row) == 0, row

    def test_grey_levels_are_rounded_to_8_bits(self, opened: tuple[X11Display, Screen]) -> None:
        display, screen = opened
        frames = random_frames((5, 9), "whole", 6, grey=True)
        for row in range(len(frames)):
            display.show(only(frames, row))
            assert screen.mismatches(frames, row) == 0, row

    def test_loading_shows_nothing_and_played_rows_end_black(
        self, opened: tuple[X11Display, Screen]
    ) -> None:
        display, screen = opened
        display.black()
        display.load(random_frames((6, 8), "whole", 12))
        assert not x11_rig.root_pixels(screen.server).any()
        display.play(lambda *_: None, lambda: False)
        assert not x11_rig.root_pixels(screen.server).any()

    def test_a_cell_without_a_pixel_is_refused(self, opened: tuple[X11Display, Screen]) -> None:
        display, screen = opened
        display.black()
        with pytest.raises(ConfigError, match="cells have no pixel on the projector's"):
            display.load(random_frames((200, 64), "whole", 4))
        assert not x11_rig.root_pixels(screen.server).any()


@pytest.mark.long
def test_cells_of_two_pixels(tmp_path: Path, x_quarter: XServer) -> None:
    """128 x 96 cells, in windows of one pixel or two, under a map that bends.

    Their pieces are more than a byte can number."""
    frames = random_frames((96, 128), "quarter", 5)
    with shown(tmp_path, x_quarter, places={"mask": BENT["mask"]}) as (display, screen):
        for row in range(4):
            display.show(only(frames, row))
            assert screen.mismatches(frames, row) == 0, row


@pytest.mark.long
@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_512_by_384_cells_on_full_panels(tmp_path: Path, x_full: XServer, window: str) -> None:
    """The mask turned and bent, the projector in place: two of its pixels to a cell."""
    frames = random_frames((384, 512), window, 5)
    with shown(tmp_path, x_full, places={"mask": BENT["mask"]}) as (display, screen):
        for row in range(3):
            display.show(only(frames, row))
            assert screen.mismatches(frames, row) == 0, row


@pytest.mark.long
def test_pictures_of_a_panels_own_pixels(tmp_path: Path, x_quarter: XServer) -> None:
    """Wherever it lies; white is every pixel of it."""
    rng = np.random.default_rng(6)
    with shown(tmp_path, x_quarter, places=BENT, boxes=ODD) as (display, screen):
        pictures = [
            pack_bits(rng.random((3, view.size_px[0] * view.size_px[1])) < 0.5)
            for view in screen.views
        ]
        index = np.array([0, 1, 2, WHITE, BLACK, 0], dtype=np.int32)
        count = index.size
        frames = Frames(
            pictures[0], pictures[1], index, index[::-1].copy(), np.zeros(count, np.uint8),
            np.arange(count, dtype=np.int32), np.zeros(count, np.bool_), (1, 1), (1, 1),
            PIXEL_WINDOW,
        )  # fmt: skip
        for row in range(count):
            display.show(only(frames, row))
            panels = x11_rig.panels(x_quarter, ODD)
            assert not panels[2]
            for found, view, shown_index, patterns in zip(
                panels[:2], screen.views, (index, index[::-1]), pictures, strict=True
            ):
                width, height = view.size_px
                which = int(shown_index[row])
                wanted = np.full((height, width), 255 * (which == WHITE), np.uint8)
                if which >= 0:
                    bits = np.unpackbits(patterns[which], count=width * height)
                    wanted = 255 * bits.reshape(height, width)
                assert np.array_equal(found, np.repeat(wanted[..., None], 3, axis=2))
                assert np.array_equal(wanted, draw(frames, view, row))
        with pytest.raises(ConfigError, match="not the projector's"):
            display.load(replace(frames, primal_patterns=pictures[0][:, :-1]))


@pytest.mark.parametrize(
    ("window", "order", "places"),
    sampled([("side-3/4", "RGB", BENT), ("whole", "GRB", None)], 2),
)
def test_24_planes_of_a_picture(
    tmp_path: Path, x_quarter: XServer, window: str, order: str, places: dict[str, Placing] | None
) -> None:
    """Row j of the frames is bit j % 8 of colour order[j // 8], under sub-shifts of its own."""
    frames = random_frames((12, 16), window, 24)
    panels = {"planes_per_refresh": 24, "plane_order": order}
    with shown(tmp_path, x_quarter, panels, places=places) as (display, screen):
        display.show(frames)
        *found, rest = x11_rig.panels(x_quarter)
    assert rest == 0
    for picture, view in zip(found, screen.views, strict=True):
        wanted = np.zeros(picture.shape, dtype=np.uint8)
        for j in range(24):
            lit = planned(frames, j, view) > 0
            wanted[..., "RGB".index(order[j // 8])] += lit.astype(np.uint8) << j % 8
        assert np.count_nonzero(picture != wanted) == 0
        np.testing.assert_array_equal(draw_planes(frames, view, range(24), order), wanted)


def test_planes_are_logged_one_by_one_and_a_delayed_mask_comes_later(
    tmp_path: Path, x_quarter: XServer
) -> None:
    frames = random_frames((6, 8), "whole", 100)
    panels = {"planes_per_refresh": 24, "mask_delay_refreshes": 1}
    with shown(tmp_path, x_quarter, panels) as (display, _):
        display.load(frames)
        with lateness.watched() as machine:
            log = display.play(lambda *_: None, lambda: False)
    if log.missed.any() or len(log) > 124:  # 24 rows that were shown again are none that were late
        machine.quiet_or_skip("a refresh was lost")
    assert len(log) == 124
    rows, black = np.arange(100), np.full(24, BLACK)
    np.testing.assert_array_equal(log.primal_shown, np.append(rows, black))
    np.testing.assert_array_equal(log.dual_shown, np.append(black, rows))
    assert log.mask_delay == 24
    assert np.median(np.diff(log.primal_ns)) == pytest.approx(1e9 / 60 / 24, rel=0.1)
