"""Light of single cells out of quads that see several: exact, whatever their number in a cell."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.placing import Placing, make_placed_map
from pdcd.pictures.exposed import ComputedShot
from pdcd.pictures.to_cells import unmix_some_cells
from pdcd.probing.realised import Factors
from pdcd.sensor.cells import CellMap

GRID = (6, 8)
NOTHING = Factors(np.zeros((1, 48)), np.zeros((1, 48)), np.zeros(48), np.zeros(48))


def cells_of(frame: tuple[int, int], turn_deg: float = 0.0, scale: float = 1.0) -> CellMap:
    place = Placing(turn_deg=turn_deg, scale=scale)
    return CellMap(
        grid=GRID, frame=frame, map=make_placed_map(place, (frame[1], frame[0]), (80, 60), "camera")
    )


@pytest.mark.parametrize(
    ("frame", "turn_deg", "scale"),
    [((24, 32), 0.0, 1.0), ((19, 25), 0.0, 1.0), ((13, 17), 0.0, 1.0), ((38, 50), 3.0, 1.2),
     ((15, 20), 2.0, 1.1)],
)  # fmt: skip
def test_cells_are_told_apart_however_few_quads_they_have(
    frame: tuple[int, int], turn_deg: float, scale: float
) -> None:
    cells = cells_of(frame, turn_deg, scale)
    rng = np.random.default_rng(3)
    values = rng.random((2, 48, 3))
    taken = []
    for light in values:
        quads = cells.spread(light)
        taken.append(ComputedShot(quads, np.full(quads.shape, 1e-4), ~cells.known, NOTHING, {}))
    wanted = np.flatnonzero(cells.seen())
    assert wanted.size == 48
    told = unmix_some_cells(taken, np.ones(frame, np.bool_), cells, wanted)
    found, error = told.light, told.error
    np.testing.assert_allclose(found, values, atol=2e-3)
    assert found.shape == error.shape and 0.0 < error.min() <= error.max() < 0.01 * 4.0
    few = unmix_some_cells(taken, np.ones(frame, np.bool_), cells, wanted[5:9])
    np.testing.assert_allclose(few.light, values[:, 5:9], atol=2e-3)
    if frame == (19, 25):  # three quads a cell: their mean holds much of the neighbours
        assert np.abs(cells.mean(taken[0].light) - values[0]).max() > 0.1
