"""Figures taken coarsely: what their photos show in numbers, each against its truth."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.figures import fig01, fig05, fig07, fig08, table1, table2
from pdcd.figures.figure import Photo
from pdcd.figures.places import patch
from tests.figures_rig import numbers_of, taken

pytestmark = pytest.mark.long


def agree(photo: Photo) -> None:
    """The error was found over the same quads by the capture itself, from its own truth."""
    assert photo.error == pytest.approx(photo.summary["rms_error_quads"], rel=1e-4)


def test_figure_1() -> None:
    photos = taken(fig01.FIGURE)
    numbers = numbers_of(fig01.FIGURE, photos)
    assert numbers["direct + indirect - white, mean, scene units"] < 1e-5
    assert photos["ours"].error < photos["paper"].error
    for photo in photos.values():
        agree(photo)
        assert photo.errors["white"] < 0.03


def test_figure_5() -> None:
    photos = taken(fig05.FIGURE)
    numbers = numbers_of(fig05.FIGURE, photos)
    assert numbers["correlation with the truth further off the diagonal"] > 0.85
    found, truth = fig05.entries(photos["slice"])
    assert np.argmax(found, axis=1) == pytest.approx(np.argmax(truth, axis=1), abs=1)


def test_figure_7() -> None:
    photos = taken(fig07.FIGURE)
    numbers = numbers_of(fig07.FIGURE, photos)
    assert photos["diagonal, codes"].error < 0.03 < photos["diagonal, proportional"].error
    # 24 cells: between the root of them and all of them.
    assert 4.0 < numbers["diagonal: error of the naive way over the proportional"] < 30.0
    assert 0.8 < numbers["indirect: error of the naive way over the proportional"] < 1.25


def test_figure_8() -> None:
    names = ("white", "1/2, ours", "1/4, ours", "1/8, ours", "1/16, ours")
    photos = taken(fig08.FIGURE, names)
    for photo in photos.values():
        agree(photo)
        assert photo.error < 0.08
    cells = {float(p): n for p, n in ((1, "white"), (2, names[1]), (16, names[4]))}
    patches = {p: patch(photos[n].image, fig08.POINTS["milk"]) for p, n in cells.items()}
    # D + p S: what p = 1/16 has left over follows from p = 1 and p = 1/2.
    direct = 2.0 * patches[2.0] - patches[1.0]
    assert patches[16.0] == pytest.approx(direct + (patches[1.0] - direct) / 16.0, rel=0.15)


def test_rows_of_the_tables() -> None:
    photos = taken(table2.FIGURE, ("row 1", "row 2", "row 5"))
    for name, most in (("row 1", 0.1), ("row 2", 0.45), ("row 5", 0.06)):
        agree(photos[name])
        assert photos[name].error < most
    photos = taken(table1.FIGURE, ("row 1", "row 2"))
    one, two = photos["row 1"].image, photos["row 2"].image
    assert np.nanmean(np.abs(one - two)) < 0.01 * np.nanmean(one)
