"""The part of the field that all devices share."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.calibration.window import WHOLE, find_shared_window
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map

SIZE = (400, 300)


def lying(left: float, right: float, top: float, bottom: float, turn_deg: float = 0.0) -> Map:
    """A device whose picture fills this rectangle of the field, turned about its middle."""
    width, height = SIZE
    scale = np.diag([(right - left) / width, (bottom - top) / height, 1.0])
    angle = np.radians(turn_deg)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    middle = np.array(
        [[1.0, 0.0, -0.5 * (right - left)], [0.0, 1.0, -0.5 * (bottom - top)], [0.0, 0.0, 1.0]]
    )
    back = np.array(
        [[1.0, 0.0, 0.5 * (left + right)], [0.0, 1.0, 0.5 * (top + bottom)], [0.0, 0.0, 1.0]]
    )
    return Map(size_px=SIZE, homography=tuple((back @ turn @ middle @ scale).ravel().tolist()))


def test_devices_that_cover_the_field_leave_it_whole() -> None:
    assert find_shared_window(Map.filling(SIZE), lying(-0.1, 1.1, -0.1, 1.1)) == WHOLE
    turned = lying(-0.05, 1.05, -0.1, 1.02, 1.0), lying(-0.1, 1.1, -0.1, 1.1, 2.0)
    assert find_shared_window(*turned) == WHOLE


@pytest.mark.parametrize("turn_deg", [0.0, 3.0])
def test_sides_move_in_to_where_all_share_it(turn_deg: float) -> None:
    mask, camera = lying(0.2, 1.2, -0.2, 1.2, turn_deg), lying(-0.2, 1.2, 0.1, 0.8)
    found = find_shared_window(mask, camera)
    assert found.left == pytest.approx(0.2, abs=0.05)
    assert found.right == 1.0
    assert found.top == pytest.approx(0.1, abs=0.04)
    assert found.bottom == pytest.approx(0.8, abs=0.04)


def test_what_hardly_meets_is_refused() -> None:
    with pytest.raises(CalibrationError, match="hardly any of the field"):
        find_shared_window(lying(0.0, 0.2, 0.0, 0.2), lying(0.8, 1.0, 0.8, 1.0))
