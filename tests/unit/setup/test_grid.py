"""Cells and field of two panels of many shapes."""

from __future__ import annotations

import pytest

from pdcd.bench.placed import describe_oblong_cells
from pdcd.bench.tables import Config, PanelConfig
from pdcd.setup.grid import choose_field

SIZES = [
    (1024, 768), (1280, 720), (1280, 800), (1366, 768), (1400, 1050), (1920, 1080), (1920, 1200),
    (3840, 2160), (800, 600), (640, 360),
]  # fmt: skip


@pytest.mark.parametrize("projector", SIZES)
@pytest.mark.parametrize("mask", [*SIZES, (1600, 1200), (1080, 1920)])
def test_cells_are_squares_of_whole_pixels_on_most_of_what_both_can_share(
    projector: tuple[int, int], mask: tuple[int, int]
) -> None:
    (left, top, wide, high), (rows, cols) = choose_field(projector, mask)
    assert wide % cols == 0 and high % rows == 0 and wide // cols == high // rows >= 8
    assert 0 <= left <= projector[0] - wide <= 2 * left + 1  # in the middle
    assert 0 <= top <= projector[1] - high <= 2 * top + 1
    most = min(projector[1], projector[0] * mask[1] / mask[0])
    assert 0.9 * most <= high <= most
    # Within half a cell the field has the mask's shape.
    assert wide / high == pytest.approx(mask[0] / mask[1], rel=1.0 / min(rows, cols))


@pytest.mark.parametrize(
    ("projector", "mask", "field", "grid"),
    [
        ((1920, 1080), (1600, 1200), (240, 0, 1440, 1080), (60, 80)),  # 18 and 20 pixels
        ((1024, 768), (1600, 1200), (0, 0, 1024, 768), (48, 64)),
        ((1024, 768), (1920, 1080), (0, 96, 1024, 576), (36, 64)),
    ],
)
def test_pixels_of_both_panels_end_with_cells_where_they_can(
    projector: tuple[int, int],
    mask: tuple[int, int],
    field: tuple[int, int, int, int],
    grid: tuple[int, int],
) -> None:
    assert choose_field(projector, mask) == (field, grid)


@pytest.mark.parametrize(
    ("grid", "told"),
    [((48, 64), "grid = [36, 64] makes squares"), ((36, 64), ""), ((39, 64), ""), ((40, 64), "ob")],
)
def test_oblong_cells_are_told_of(grid: tuple[int, int], told: str) -> None:
    config = Config(projector=PanelConfig(size_px=(1920, 1080)))
    words = describe_oblong_cells(config, grid)
    assert told in words and bool(told) == bool(words)
