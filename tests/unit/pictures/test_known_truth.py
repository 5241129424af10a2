"""A truth that is known: kept in a run folder, and compared where photos and it can be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.panels.map import Map
from pdcd.pictures.picture import PictureWithErrors
from pdcd.pictures.truth import KnownAnswer, read_known_answer, write_known_answer
from pdcd.sensor.cells import CellMap

CELLS = CellMap(grid=(2, 3), frame=(4, 6), map=Map.filling((6, 4)))


@pytest.mark.parametrize("of_cells", [True, False])
def test_the_truth_is_kept_and_compared_where_it_can_be(of_cells: bool, tmp_path: Path) -> None:
    shape = (6,) if of_cells else (4, 6)
    rng = np.random.default_rng(0)
    truth = rng.random((*shape, 3)).astype(np.float32)
    seen = np.ones(shape, np.bool_)
    seen[-1] = False
    known = KnownAnswer(truth, seen, of_cells=of_cells)
    write_known_answer(tmp_path, known)
    back = read_known_answer(tmp_path, CELLS)
    assert np.array_equal(back.image, truth) and np.array_equal(back.seen, seen)
    assert back.of_cells is of_cells
    other = CellMap(grid=(3, 2), frame=(6, 4), map=Map.filling((4, 6)))
    fewer = CellMap(grid=(2, 2), frame=(4, 4), map=Map.filling((4, 4)))
    with pytest.raises(DecodeError, match="does not fit"):
        read_known_answer(tmp_path, fewer if of_cells else other)
    # Off by a tenth where it is seen, by anything where it is not.
    found: Any = truth * 1.1
    found[~seen] = 99.0
    sigma = np.zeros((4, 6, 3), np.float32)
    quads: Any = found if not of_cells else np.zeros((4, 6, 3))
    picture = PictureWithErrors(quads, sigma, sigma, sigma, "sensor")
    none = np.zeros((2, 3, 3), np.float32)
    by_cell: Any = found.reshape(2, 3, 3) if of_cells else none
    means = PictureWithErrors(by_cell, none, none, none, "sensor")
    assert known.rms_errors(picture, means, CELLS)[of_cells] == pytest.approx(0.1, rel=1e-5)
    dark = KnownAnswer(0.0 * truth, seen, of_cells=of_cells)
    assert dark.rms_errors(picture, means, CELLS) == (None, None)
    on_quads, there = known.on_quads(CELLS)
    assert on_quads.shape == (4, 6, 3) and there.shape == (4, 6)
    on_cells = known.on_cells(CELLS)
    assert on_cells.shape == (2, 3, 3) and np.isfinite(on_cells[0]).all()
    assert np.isnan(on_cells).any()


def test_squares_of_quads_are_known_where_all_of_them_are() -> None:
    image = np.arange(5 * 7 * 3, dtype=np.float64).reshape(5, 7, 3)
    seen = np.ones((5, 7), np.bool_)
    seen[1, 2] = False
    known = KnownAnswer(image[:4, :6], seen[:4, :6], of_cells=False)
    found = known.binned(2)
    assert found.seen.tolist() == [[True, False, True], [True, True, True]]
    assert not found.of_cells and found.image.shape == (2, 3, 3)
    assert found.image[0, 0] == pytest.approx(image[:2, :2].mean(axis=(0, 1)))
    assert known.binned(1) is known
    cells = KnownAnswer(image.reshape(-1, 3), seen.ravel(), of_cells=True)
    assert cells.binned(2) is cells
    assert KnownAnswer(image, seen, of_cells=False).binned(2).seen.shape == (2, 3)
