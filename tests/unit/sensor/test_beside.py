"""Quads that look beside a panel are not known, and neither are cells that none but such see."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.panels.placing import Placing, make_placed_map
from pdcd.sensor.cells import CellMap

PROJECTOR, QUADS = (64, 48), (128, 96)


def cells_of(blur_quads: float = 0.0, **place: object) -> CellMap:
    """12 x 16 cells of 4 x 4 projector pixels, 8 x 8 quads each, behind a mask of the same size."""
    mask = make_placed_map(Placing(**place), PROJECTOR, PROJECTOR, "mask")  # type: ignore[arg-type]
    camera = make_placed_map(Placing(), QUADS, PROJECTOR, "camera")
    return CellMap(
        grid=(12, 16), frame=(96, 128), map=camera, panels=(mask,), blur_quads=blur_quads
    )


@pytest.mark.parametrize("blur_quads", [0.0, 0.4, 1.0])
def test_what_a_shifted_mask_leaves_out_is_not_known(blur_quads: float) -> None:
    """Shifted by 10.1 px to the right, 20.2 quads: two columns of cells have none, a third half of
    its quads. A blur reaches two deviations further."""
    cells = cells_of(blur_quads, offset_px=(10.1, 0.0))
    more = int(np.ceil(2.0 * blur_quads))
    # Half of the mask's pixel, a quad, may lie beside.
    assert not cells.known[:, : 20 + more].any() and cells.known[:, 20 + more :].all()
    seen = cells.seen().reshape(12, 16)
    assert not seen[:, :2].any() and seen[:, 2:].all()
    image = np.random.default_rng(1).random((96, 128, 3))
    means = cells.mean(image).reshape(12, 16, 3)
    assert (means[:, :2] == 0.0).all()
    if blur_quads == 0.0:
        part = image[:8, 20:24].reshape(-1, 3).mean(axis=0)
        np.testing.assert_allclose(means[0, 2], part)


def test_a_turned_mask_hides_corners() -> None:
    cells = cells_of(turn_deg=10.0)
    known = cells.known
    assert not known[0, 0] and not known[-1, -1] and known[48, 64]
    y, x = np.mgrid[:96, :128] + 0.5
    turn = np.radians(-10.0)
    right, down = (x - 64.0) / 2.0, (y - 48.0) / 2.0
    across = right * np.cos(turn) - down * np.sin(turn)
    along = right * np.sin(turn) + down * np.cos(turn)
    inside = np.minimum(32.0 - np.abs(across), 24.0 - np.abs(along))
    assert known[inside > 0.5].all() and not known[inside < -0.6].any()
