"""The picture of docs/calibration.md: ``python -m tests.bench.field_picture docs/field.svg``.

All that it shows goes through the maps themselves, so it cannot say anything else than they do.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdcd.panels.map import Map
from pdcd.panels.placing import Placing, make_placed_map

Floats = NDArray[np.float64]

PROJECTOR_PX = (8, 6)
MASK = make_placed_map(Placing(turn_deg=180.0, scale=1.1), (12, 9), PROJECTOR_PX, "mask")
CAMERA = make_placed_map(
    Placing(turn_deg=-8.0, scale=1.2, offset_px=(0.2, -0.1), radial=(0.02, 0.0)),
    (15, 10),
    PROJECTOR_PX,
    "camera",
)
GRID = (3, 4)
CELL = (1, 2)
"""Row and column of the cell that is marked everywhere."""

FIELD_AT, FIELD_SIZE = np.array([375.0, 95.0]), np.array([210.0, 157.5])
BLUE, ORANGE, GREEN, GREY = "#1f5fa8", "#c77700", "#009e73", "#888"


def picture() -> str:
    """The picture as SVG."""
    return "\n".join([*_head(), *_field(), *_devices(), *_arrows(), "</svg>"]) + "\n"


def _head() -> Iterator[str]:
    name = "One field, and the maps of projector, mask and camera to it"
    yield (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 960 560" width="960" height="560" '
        'font-family="DejaVu Sans, Verdana, Arial, sans-serif" font-size="13" role="img" '
        f'aria-label="{name}">'
    )
    yield (
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" '
        'markerHeight="8" orient="auto"><path d="M0,0 L10,5 L0,10 z" fill="#333"/></marker></defs>'
    )
    yield '<rect x="0" y="0" width="960" height="560" fill="#ffffff"/>'


def _field() -> Iterator[str]:
    """The field with its grid of cells, and what the devices cover of it."""
    rows, cols = GRID
    row, col = CELL
    yield _shape(_on_field(_box(col / cols, row / rows, (col + 1) / cols, (row + 1) / rows)),
                 fill="#fff3c4")  # fmt: skip
    for k in range(cols + 1):
        yield _shape(_on_field([[k / cols, 0.0], [k / cols, 1.0]]), stroke=GREY)
    for k in range(rows + 1):
        yield _shape(_on_field([[0.0, k / rows], [1.0, k / rows]]), stroke=GREY)
    yield _shape(_on_field(_box(0.0, 0.0, 1.0, 1.0)), stroke="#333", width=2.0)
    for map_, colour in ((MASK, ORANGE), (CAMERA, GREEN)):
        yield _shape(_on_field(map_.to_field(_edge(map_.size_px))), stroke=colour, width=1.6)
    yield _text(480, 24, "the field: as the projector sees the scene", bold=True)
    yield _text(380, 110, "(0, 0)", anchor="start")
    yield _text(580, 247, "(1, 1)", anchor="end")


def _devices() -> Iterator[str]:
    """The pixels of each device; those whose centre the marked cell holds are filled."""
    shown = (
        ("projector", Map.filling(PROJECTOR_PX), BLUE, (40.0, 120.0), 26.0, "8 x 6 pixels"),
        ("mask, upside down", MASK, ORANGE, (700.0, 110.0), 18.0, "12 x 9 pixels"),
        ("camera, turned, with a lens", CAMERA, GREEN, (367.5, 385.0), 15.0, "15 x 10 Bayer quads"),
    )
    for name, map_, colour, at, scale, says in shown:
        width, height = map_.size_px
        cell = np.floor(map_.centres() * (GRID[1], GRID[0]))
        inside = (cell == (CELL[1], CELL[0])).all(axis=-1)
        for y in range(height):
            for x in range(width):
                fill = colour if inside[y, x] else "none"
                corners = np.array(at) + scale * np.array(_box(x, y, x + 1, y + 1))
                yield _shape(corners, stroke="#bbb", fill=fill)
                centre = np.array(at) + scale * np.array([x + 0.5, y + 0.5])
                yield f'<circle cx="{centre[0]:.1f}" cy="{centre[1]:.1f}" r="1.1" fill="#555"/>'
        # Where the edge of the marked cell lies on the device.
        rim = _along(_box(CELL[1] / 4, CELL[0] / 3, (CELL[1] + 1) / 4, (CELL[0] + 1) / 3))
        yield _shape(np.array(at) + scale * map_.from_field(rim), stroke="#111", width=2.4)
        middle = at[0] + 0.5 * scale * width
        yield _text(middle, at[1] - 12, name, bold=True, colour=colour)
        yield _text(middle, at[1] + scale * height + 18, says)


def _arrows() -> Iterator[str]:
    """Homographies lead from the pixels to the field."""
    for x1, y1, x2, y2 in ((252, 174, 326, 174), (696, 174, 634, 174), (480, 355, 480, 312)):
        yield (
            f'<path d="M{x1},{y1} L{x2},{y2}" stroke="#333" stroke-width="1.8" fill="none" '
            'marker-end="url(#tip)"/>'
        )
    yield _text(289, 164, "to_field")
    yield _text(664, 164, "to_field")
    yield _text(490, 340, "to_field", anchor="start")
    for row, line in enumerate(
        (
            "Pixel k covers k to k + 1;",
            "the dot is its centre, k + 0.5.",
            "A pixel shows the cell that its",
            "centre lies in; beyond the field",
            "it is black. Outlined: the same cell,",
            "by from_field.",
        )
    ):
        yield _text(40, 410 + 20 * row, line, anchor="start")
    for row, line in enumerate(
        (
            "The field: x right, y down, 0 to 1.",
            "Its grid here: 3 x 4 cells.",
            "to_field takes distortion out, then",
            "the homography leads from (x, y, 1)",
            "in pixels to the field.",
        )
    ):
        yield _text(700, 410 + 20 * row, line, anchor="start")


def _box(left: float, top: float, right: float, bottom: float) -> list[list[float]]:
    return [[left, top], [right, top], [right, bottom], [left, bottom], [left, top]]


def _edge(size_px: tuple[int, int]) -> Floats:
    return _along(_box(0.0, 0.0, *size_px))


def _along(corners: list[list[float]]) -> Floats:
    """A line through corners, with points between them that a map may bend."""
    at = np.linspace(0.0, len(corners) - 1, 12 * (len(corners) - 1) + 1)
    there = np.array(corners, dtype=np.float64)
    return np.stack([np.interp(at, np.arange(len(corners)), there[:, k]) for k in (0, 1)], axis=-1)


def _on_field(points: ArrayLike) -> Floats:
    return np.asarray(FIELD_AT + FIELD_SIZE * np.asarray(points, dtype=np.float64))


def _shape(points: Floats, stroke: str = "none", fill: str = "none", width: float = 1.0) -> str:
    way = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{way}" stroke="{stroke}" stroke-width="{width}" fill="{fill}"/>'


def _text(
    x: float,
    y: float,
    text: str,
    *,
    anchor: str = "middle",
    bold: bool = False,
    colour: str = "#333",
) -> str:
    weight = ' font-weight="bold"' if bold else ""
    said = text.replace(">", "&gt;")
    style = f'text-anchor="{anchor}" fill="{colour}"{weight}'
    return f'<text x="{x:.1f}" y="{y:.1f}" {style}>{said}</text>'


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(picture(), encoding="utf-8")
