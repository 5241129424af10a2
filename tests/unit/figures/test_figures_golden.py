"""Figures ask for the captures, and make of photos, what they did when their bounds were stated.

`tests/data/figures.json` has each figure's captures, and what it shows of photos that are made up:
numbers with their bounds, panels, lines of plots. Where a figure is changed on purpose, write it
anew by ``python -m tests.unit.figures.test_figures_golden``, and look at what has changed.
"""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.reading import TOML_TIME_TYPES
from pdcd.figures.bench import make_figure_config
from pdcd.figures.catalog import FIGURES
from pdcd.figures.figure import (
    BoundedNumber,
    FigureMode,
    FigurePhoto,
    FigurePlot,
    FigureTake,
    PanelRow,
    PaperFigure,
)
from tests.figures_rig import TINY_MODE
from tests.golden import alike, keep, kept_in, plain
from tests.places import DATA

GOLDEN = DATA / "figures.json"
MODES = {
    "quick": FigureMode("quick", (24, 32), (240, 160), 100, True, thrift=4, least_codes=16),
    "whole": FigureMode("whole", (24, 32), (240, 160), 100, False),
}
"""All that the pages have, with few cells."""
NAMES = ("answer", "white", "direct", "indirect", "high", "low")


def made_up(name: str, take: FigureTake, grid: tuple[int, int]) -> FigurePhoto:
    """A photo whose numbers are chance, and always the same."""
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")
    rng = np.random.default_rng(seed)

    def picture() -> Any:
        coarse = rng.random((*grid, 3)).repeat(6, axis=0).repeat(6, axis=1)
        return (0.2 + 0.6 * coarse + 0.2 * rng.random(coarse.shape)).astype(np.float32)

    pictures, truths = ({one: picture() for one in NAMES} for _ in range(2))
    errors = {one: 0.01 * (k + 1) for k, one in enumerate(NAMES)}
    cells = grid[1]
    found, true = (rng.random((cells, cells, 3)) + np.eye(cells)[..., None] for _ in range(2))
    codes = int(take.asked.get("codes", 8))
    return FigurePhoto(
        pictures, truths, errors, found, true, {"codes": codes, "exposure_s": 2.5}, grid
    )


def asked(figure: PaperFigure, mode: FigureMode) -> dict[str, Any]:
    return {
        name: plain({field: getattr(take, field) for field in FigureTake.__dataclass_fields__})
        for name, take in figure.takes(mode).items()
    }


def shown(figure: PaperFigure, mode: FigureMode) -> dict[str, Any]:
    photos = {n: made_up(n, take, mode.grid) for n, take in figure.takes(mode).items()}
    found = list(figure.shown(mode, photos))
    rows = [
        [row.title, row.small, [plain({k: getattr(p, k) for k in FIELDS}) for p in row.panels]]
        for row in found
        if isinstance(row, PanelRow)
    ]
    plots = [_told_of(plot) for plot in found if isinstance(plot, FigurePlot)]
    numbers = [plain(msgspec.to_builtins(n)) for n in found if isinstance(n, BoundedNumber)]
    return {"rows": rows, "plots": plots, "numbers": numbers}


def _told_of(plot: FigurePlot) -> Any:
    lines = [{**vars(one), "x": np.asarray(one.x), "y": np.asarray(one.y)} for one in plot.lines]
    return plain({**vars(plot), "lines": lines})


FIELDS = ("image", "caption", "white", "signed", "kind")
TAKES = {
    "plain": FigureTake("open-book", "white"),
    "perfect": FigureTake("open-book", "white", perfect=True),
    "off axis": FigureTake(
        "box-wall", "keyed", options={"disparity": 0.5}, off_axis=True, f_number=4.0
    ),
    "own grid": FigureTake("open-book", "white", grid=(6, 8)),
}


def bench(take: FigureTake, mode: FigureMode, folder: Path) -> dict[str, Any]:
    """Its configuration and its truth, without the folder that they lie in."""
    told = make_figure_config(take, mode, folder)
    told_of = msgspec.to_builtins(told, builtin_types=TOML_TIME_TYPES)
    assert told_of.pop("server")["state_dir"] == str(folder)
    assert told_of.pop("bench")["truth"] == (None if take.perfect else str(folder / "truth.toml"))
    truth = "" if take.perfect else (folder / "truth.toml").read_text(encoding="utf-8")
    return {"believed": plain(told_of), "true": truth}


@pytest.fixture(scope="module")
def golden() -> dict[str, Any]:
    return kept_in(GOLDEN)


@pytest.mark.parametrize("mode", list(MODES))
@pytest.mark.parametrize("number", list(FIGURES))
def test_a_figure_asks_for_the_captures_that_it_did(
    number: str, mode: str, golden: dict[str, Any]
) -> None:
    alike(asked(FIGURES[number], MODES[mode]), golden["asked"][f"{number}, {mode}"], number)


@pytest.mark.parametrize("mode", list(MODES))
@pytest.mark.parametrize("number", list(FIGURES))
def test_a_figure_makes_of_photos_what_it_did(
    number: str, mode: str, golden: dict[str, Any]
) -> None:
    found = plain(shown(FIGURES[number], MODES[mode]))
    alike(found, golden["shown"][f"{number}, {mode}"], number)


@pytest.mark.parametrize("name", list(TAKES))
def test_the_bench_of_figures_is_as_it_was(
    name: str, golden: dict[str, Any], tmp_path: Path
) -> None:
    alike(bench(TAKES[name], TINY_MODE, tmp_path), golden["bench"][name], name)


if __name__ == "__main__":
    kept: dict[str, dict[str, Any]] = {"asked": {}, "shown": {}, "bench": {}}
    for number in FIGURES:
        for mode_name, mode in MODES.items():
            key = f"{number}, {mode_name}"
            kept["asked"][key] = asked(FIGURES[number], mode)
            kept["shown"][key] = plain(shown(FIGURES[number], mode))
    with tempfile.TemporaryDirectory() as folder:
        for name, take in TAKES.items():
            kept["bench"][name] = bench(take, TINY_MODE, Path(folder))
    keep(GOLDEN, kept)
