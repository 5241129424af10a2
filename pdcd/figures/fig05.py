"""Figure 5: a slice of the transport matrix, one row of cells under one row of the projector.

Entry (n, m) is the light that camera cell n of the row receives from projector cell m of the same
row. It is measured by lighting half of the row's cells at a time (S-matrices, as by Schechner).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigurePanel,
    FigurePhoto,
    FigurePlot,
    FigureTake,
    Line,
    PanelRow,
    PaperFigure,
    Photos,
)

_PLACE = 0.525
"""Where the row lies, as a share of the field's height: across rod, wax, book, mirror and globe."""
_PARTS: dict[str, tuple[float, float]] = {
    "caustics of the glass rod: streaks": (0.0, 0.20),
    "wax: a band along the diagonal": (0.12, 0.42),
    "book: a fan to either side": (0.38, 0.66),
    "mirror: lines across": (0.64, 0.98),
}
"""Parts that are magnified, as shares of the field's width."""
_LINES = {"wax": 0.25, "book": 0.46, "mirror": 0.76}
"""Camera cells whose rows of T are drawn as lines, as shares of the field's width."""
_DEEPEST = 1e-3
"""Darkest entries that are still shown, as a share of the brightest."""


def _row_of(mode: FigureMode) -> int:
    """The row of cells that is photographed."""
    return int(_PLACE * mode.grid[0])


def takes(mode: FigureMode) -> dict[str, FigureTake]:
    """The slice, and the scene itself."""
    row = _row_of(mode)
    return {
        # Under one row of light a still-life has detail within its cells. A cell is measured as the
        # mean of its values, which differs by some per cent from its own transport.
        "slice": FigureTake(
            "still-life", "transport", {"rows": (row, row)}, bound=0.11, said="S-matrix"
        ),
        "scene": FigureTake("still-life", "white", said="all light"),
    }


def shown(mode: FigureMode, photos: Photos) -> Iterator[PanelRow | FigurePlot | BoundedNumber]:
    """The scene with its row marked, the slice next to its truth, and four parts of it."""
    found, truth = average_entries(photos["slice"])
    top, cols = float(np.percentile(truth.diagonal(), 95.0)), mode.grid[1]
    marked = _mark_row(photos["scene"].image, _row_of(mode), mode.grid[0])
    whole = (
        FigurePanel(marked, "the scene, row marked"),
        FigurePanel(_shades(found, top), "slice, measured", kind="grey"),
        FigurePanel(_shades(truth, top), "slice, truth", kind="grey"),
    )
    yield PanelRow(whole, "Brightness of the slice goes by the logarithm, over three decades")
    parts = []
    for words, (left, right) in _PARTS.items():
        part = slice(int(left * cols), int(np.ceil(right * cols)))
        parts.append(FigurePanel(_shades(found[part, part], top), words, kind="grey"))
    yield PanelRow(tuple(parts), "Parts of the measured slice")
    yield _profile(found, truth, cols)

    near = np.abs(np.subtract.outer(*2 * (np.arange(len(found)),))) <= 1
    share, true = (float(one[near].sum() / one.sum()) for one in (found, truth))
    what = "share of light within one cell of the diagonal"
    yield BoundedNumber(what, share, true - 0.03, true + 0.03, percent=True)
    far = float(np.corrcoef(found[~near], truth[~near])[0, 1])
    yield BoundedNumber("correlation with the truth further off the diagonal", far, least=0.95)
    # Off the diagonal a path and its reverse carry the same light through the same colours; they
    # differ only by noise, and by detail within cells.
    back = float(np.sum(found[~near] * found.T[~near]) / np.sum(np.square(found)[~near]))
    yield BoundedNumber("a path and its way back, correlated, further off", back, least=0.9)


def average_entries(photo: FigurePhoto) -> tuple[NDArray[Any], NDArray[Any]]:
    """Measured and true entries as one grey, (C, J); 0 where nothing is known."""
    if photo.transport is None or photo.transport_truth is None:
        raise ValueError("no entries were photographed")
    return np.nan_to_num(photo.transport).mean(axis=-1), photo.transport_truth.mean(axis=-1)


def _shades(entries: NDArray[Any], top: float) -> NDArray[np.uint8]:
    """Entries as pixels on a logarithmic scale: `top` is white, `_DEEPEST` of it is black."""
    share = np.log10(np.maximum(entries / top, _DEEPEST)) / np.log10(_DEEPEST)
    drawn: NDArray[np.uint8] = np.rint(255.0 * np.clip(1.0 - share, 0.0, 1.0)).astype(np.uint8)
    return drawn


def _mark_row(image: NDArray[Any], row: int, rows: int) -> NDArray[Any]:
    """A picture with thin lines above and below one row of cells."""
    shown = np.array(np.broadcast_to(image, (*image.shape[:2], 3)))
    bright = np.float32(np.nanpercentile(image, 99.0)) * np.array([1.0, 0.8, 0.1], np.float32)
    for edge in (row, row + 1):
        at = round(edge / rows * len(shown))
        shown[at : at + max(len(shown) // 300, 1)] = bright
    return shown


def _profile(found: NDArray[Any], truth: NDArray[Any], cols: int) -> FigurePlot:
    lines = []
    for index, (words, at) in enumerate(_LINES.items()):
        cell, label = int(at * cols), f"camera cell {int(at * cols)}, {words}"
        x = np.arange(len(truth[cell]))
        lines.append(Line(x, truth[cell], style="--", colour=index))
        lines.append(Line(x, found[cell], label, colour=index))
    return FigurePlot(
        "rows",
        "Rows of the slice: measured (line), truth (dashed)",
        "projector cell",
        "light at full power, scene units",
        "Three rows of the slice: where the light of one camera cell is from.",
        tuple(lines),
        scales=("linear", "symlog"),
    )


FIGURE = PaperFigure(
    "5",
    "A slice of the transport matrix",
    see=(
        "Most light stays near the diagonal; glass throws streaks off it, wax is a band, the book "
        "a fan, the mirror lines across."
    ),
    paper="One row of its scene by multiplexed light (Schechner et al.), one photo a pattern.",
    unlike=(
        "the paper's slice has a row for every pixel, this one for every cell; our scene has no "
        "unicorn and no peppers."
    ),
    takes=takes,
    shown=shown,
)
