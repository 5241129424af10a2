"""Figure 7: three ways to one picture in the same time, at the same aperture.

Path isolation lights one cell and opens one cell at a time. Naively every pair of cells has its
slot; in proportion only those that are wanted have one. Codes use half of all cells at any time.
All are exact, but their light, and so their noise, are not alike.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdcd.figures.draw import white_of
from pdcd.figures.figure import Figure, Line, Mode, Number, Panel, Photos, Plot, Row, Take
from pdcd.sensor.profile import load_profile
from pdcd.words import FamilyName, GoalName

GRID = (4, 6)
"""Cells of these photos: pairs grow with the square of their number."""
CELLS = GRID[0] * GRID[1]
SECONDS = 9.7
"""Exposure of each photo: one refresh for each pair of cells, at 60 Hz."""
F_NUMBERS: dict[GoalName, float] = {"diagonal": 40.0, "indirect": 11.0}
"""Apertures at which codes expose the sensor well."""
BOUNDS: dict[GoalName, tuple[float, float]] = {"diagonal": (0.018, 0.021), "indirect": (0.15, 0.23)}
"""Of the quick and of the full page, whose quads see the borders of cells more sharply."""
LEAST_GAIN = 4.0, 2.7
"""By which codes are better for indirect light, on either."""
WAYS: dict[str, FamilyName] = {
    "naive": "isolation",
    "proportional": "confocal",
    "codes": "hadamard",
}
ASKED = {
    "guards": "none",
    "window": "whole",
    "black_level": "none",
    "smooth": False,
    "pilot": 0,
    "parts": 1,
    "codes": 32,
}
"""Codes are at least as many as cells, so that they are exact, too."""
PAPER_CELLS = 3072


def takes(mode: Mode) -> dict[str, Take]:
    """Either goal by three ways, before a bench whose panels show every refresh as it is."""
    found = {}
    for goal, f_number in F_NUMBERS.items():
        for way, family in WAYS.items():
            # Of signed codes a photo shows every one twice.
            exposure_s = SECONDS / (1 + (goal == "diagonal" and way == "codes"))
            white = goal != "indirect"
            found[f"{goal}, {way}"] = Take(
                "open-book",
                goal,
                {**ASKED, "family": family, "exposure_s": exposure_s, "white": white},
                grid=GRID,
                perfect=True,
                f_number=f_number,
                all_codes=True,
                # Exact but for noise, and for quads that see the borders of such large cells: only
                # codes have light enough for a picture.
                bound=mode.bound(*BOUNDS[goal]) if way == "codes" else None,
                said="as in the paper" if way != "codes" else "more codes than cells: exact",
            )
    return found


def shown(mode: Mode, photos: Photos) -> Iterator[Row | Plot | Number]:
    """Both goals by all ways beside the truth, and noise over the number of cells."""
    for goal in F_NUMBERS:
        truth = photos[f"{goal}, codes"].truth
        white = white_of(truth)
        panels = [Panel(photos[f"{goal}, {way}"].image, way, white) for way in WAYS]
        yield Row((*panels, Panel(truth, "truth", white)), goal)
    yield _noise()
    # N slots instead of N^2 have N times the light: sqrt(N) of noise where photons decide, N
    # where read noise does. Error of what is not noise is no more than the bound of codes.
    yield _gain(photos, "diagonal", "the proportional", 0.7 * CELLS**0.5, 1.3 * CELLS)
    # All but N of the pairs are wanted: nothing is gained.
    yield _gain(photos, "indirect", "the proportional", 0.8, 1.3)
    # A quarter of the light against 1/N^2 of it; what codes have left is borders of cells.
    yield _gain(photos, "indirect", "codes", mode.bound(*LEAST_GAIN), None)


def _gain(photos: Photos, goal: str, over: str, least: float, most: float | None) -> Number:
    gain = photos[f"{goal}, naive"].error / photos[f"{goal}, {over.split()[-1]}"].error
    return Number(f"{goal}: error of the naive way over {over}", gain, least, most)


def _noise() -> Plot:
    """What one pixel's noise is, by the sensor model: signal and read noise of one photo."""
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
    return Plot(
        "cells",
        "One photo, EOS 450D at ISO 100",
        "cells N",
        "signal over noise of a pixel",
        "With the paper's 3072 cells naive isolation gives each pair 3.2 microseconds of 30 s: far "
        "below the read noise. Codes do not care how many cells there are.",
        tuple(lines),
        scales=("log", "log"),
        marks=((CELLS, "here"), (PAPER_CELLS, "64 x 48")),
        level=1.0,
        y_range=(1e-4, 1e3),
    )


FIGURE = Figure(
    "7",
    "Path isolation, naive and in proportion, against codes",
    see="The same picture in the same time: noise hides what isolation sees, codes show it.",
    paper="algorithms only; no photos of them are printed.",
    unlike="",
    takes=takes,
    shown=shown,
)
