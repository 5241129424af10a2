"""The plane of a card, by the camera's maps onto two of them."""

from __future__ import annotations

import numpy as np

from pdcd.calibration.geometry.disparity import fit_card_plane
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing, make_placed_map


def test_k5_a_card_at_another_depth_gives_its_plane() -> None:
    """The same camera on two cards: the second map is the first, and then the plane."""
    now = make_placed_map(Placing(turn_deg=-3.0, scale=1.1), (300, 200), (128, 96), "camera")
    plane = np.array([[1.02, 0.01, -0.05], [0.005, 0.99, 0.0], [0.03, 0.0, 1.0]])
    then = now.then(plane)
    assert isinstance(then, Map)
    found, left = fit_card_plane(now, then)
    np.testing.assert_allclose(np.reshape(found, (3, 3)), plane, atol=1e-6)
    assert left < 1e-7
