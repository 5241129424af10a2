"""Figure 7: three ways to one picture in the same time, at the same aperture.

Path isolation lights one cell and opens one cell at a time. The naive way gives every pair of cells
a slot; the proportional way only the wanted pairs. Codes use half of all cells at any time. All
ways are exact, but they gather different amounts of light, and so have different noise.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdcd.figures.draw import white_of
from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigurePanel,
    FigurePlot,
    FigureTake,
    Line,
    PanelRow,
    PaperFigure,
    Photos,
)
from pdcd.sensor.profile import load_profile
from pdcd.words import FamilyName, GoalName

GRID = (4, 6)
"""Rows and columns of cells of these photos; few, as pairs grow with the square of their number."""
_CELLS = GRID[0] * GRID[1]
_SECONDS = 9.7
"""Exposure of each photo: one refresh for each pair of cells, at 60 Hz."""
_F_NUMBERS: dict[GoalName, float] = {"diagonal": 40.0, "indirect": 11.0}
"""Apertures at which codes expose the sensor well."""
_BOUNDS: dict[GoalName, tuple[float, float]] = {
    "diagonal": (0.018, 0.021),
    "indirect": (0.15, 0.23),
}
"""Bounds of the errors on the quick and on the full page, whose quads see the borders of cells more
sharply."""
_LEAST_GAIN = 4.0, 2.7
"""Least factor by which codes are better for indirect light, on either page."""
_WAYS: dict[str, FamilyName] = {
    "naive": "isolation",
    "proportional": "confocal",
    "codes": "hadamard",
}
_ASKED = {
    "guards": "none",
    "window": "whole",
    "black_level": "none",
    "smooth": False,
    "pilot": 0,
    "parts": 1,
    "codes": 32,
}
"""Fields of every request; there are at least as many codes as cells, so that codes are exact."""
_PAPER_CELLS = 3072


def list_fig07_takes(mode: FigureMode) -> dict[str, FigureTake]:
    """Either goal in three ways, on a bench whose panels show every refresh as it is."""
    found = {}
    for goal, f_number in _F_NUMBERS.items():
        for way, family in _WAYS.items():
            # With signed codes, a photo shows each code twice.
            exposure_s = _SECONDS / (1 + (goal == "diagonal" and way == "codes"))
            white = goal != "indirect"
            found[f"{goal}, {way}"] = FigureTake(
                "open-book",
                goal,
                {**_ASKED, "family": family, "exposure_s": exposure_s, "white": white},
                grid=GRID,
                perfect=True,
                f_number=f_number,
                all_codes=True,
                # Exact but for noise, and for quads that see the borders of such large cells: only
                # codes have light enough for a picture.
                bound=mode.bound(*_BOUNDS[goal]) if way == "codes" else None,
                said="as in the paper" if way != "codes" else "more codes than cells: exact",
            )
    return found


def shown(mode: FigureMode, photos: Photos) -> Iterator[PanelRow | FigurePlot | BoundedNumber]:
    """Both goals in all ways next to the truth, and noise against the number of cells."""
    for goal in _F_NUMBERS:
        truth = photos[f"{goal}, codes"].truth
        white = white_of(truth)
        panels = [FigurePanel(photos[f"{goal}, {way}"].image, way, white) for way in _WAYS]
        yield PanelRow((*panels, FigurePanel(truth, "truth", white)), goal)
    yield _noise()
    # With N slots instead of N^2 there is N times the light: noise is less by sqrt(N) if photons
    # dominate it, by N if read noise does. Errors other than noise are within the codes' bound.
    yield _gain(photos, "diagonal", "the proportional", 0.7 * _CELLS**0.5, 1.3 * _CELLS)
    # All pairs but N are wanted, so nothing is gained.
    yield _gain(photos, "indirect", "the proportional", 0.8, 1.3)
    # A quarter of the light against 1/N^2 of it; the remaining error of codes is at cell borders.
    yield _gain(photos, "indirect", "codes", mode.bound(*_LEAST_GAIN), None)


def _gain(photos: Photos, goal: str, over: str, least: float, most: float | None) -> BoundedNumber:
    gain = photos[f"{goal}, naive"].error / photos[f"{goal}, {over.split()[-1]}"].error
    return BoundedNumber(f"{goal}: error of the naive way over {over}", gain, least, most)


def _noise() -> FigurePlot:
    """The noise of one pixel by the sensor model: signal and read noise of one photo."""
    body = load_profile("450d")
    read_e, full_e = body.row(100).read_noise_e, 0.13 * body.full_well_e
    cells = np.geomspace(4, 1e5, 100)
    shares = {
        "naive: 1/N^2 of the light": cells**-2.0,
        "proportional, diagonal: 1/N": cells**-1.0,
        "codes: 1/4": np.full_like(cells, 0.25),
    }
    lines = []
    for index, (label, share) in enumerate(shares.items()):
        signal_e = full_e * share / 0.25
        lines.append(Line(cells, signal_e / np.sqrt(signal_e + read_e**2), label, colour=index))
    return FigurePlot(
        "cells",
        "One photo, EOS 450D at ISO 100",
        "cells N",
        "signal over noise of a pixel",
        "With the paper's 3072 cells naive isolation gives each pair 3.2 microseconds of 30 s: far "
        "below the read noise. Codes do not care how many cells there are.",
        tuple(lines),
        scales=("log", "log"),
        marks=((_CELLS, "here"), (_PAPER_CELLS, "64 x 48")),
        level=1.0,
        y_range=(1e-4, 1e3),
    )


FIGURE = PaperFigure(
    "7",
    "Path isolation, naive and in proportion, against codes",
    see="The same picture in the same time: noise hides what isolation sees, codes show it.",
    paper="algorithms only; no photos of them are printed.",
    unlike="",
    takes=list_fig07_takes,
    shown=shown,
)
