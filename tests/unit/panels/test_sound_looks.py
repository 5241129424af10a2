"""How closely a map is looked at before it is trusted: at which points, and to which error."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.map_soundness import check_map

GOOD = Map.filling((64, 48))


@pytest.mark.parametrize(
    ("rows", "cols", "points"),
    [(0, 0, 33), (2, 2, 33), (9, 9, 33), (2, 10, 37), (10, 2, 37), (32, 5, 125)],
)
def test_a_device_is_looked_at_evenly_with_its_corners(
    rows: int, cols: int, points: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 33 points a side, or at four from each node of a residual to the next."""
    seen: list[np.ndarray] = []
    real = Map.to_field

    def noted(self: Map, given: Any) -> Any:
        seen.append(np.array(given))
        return real(self, given)

    monkeypatch.setattr(Map, "to_field", noted)
    map_ = msgspec.structs.replace(GOOD, residual=(((0.0, 0.0),) * cols,) * rows)
    assert check_map(map_, "mask") is map_
    (given,) = seen
    assert given.shape == (points, points, 2)
    np.testing.assert_allclose(given[0, :, 0], np.linspace(0.0, 64.0, points))
    np.testing.assert_allclose(given[:, 0, 1], np.linspace(0.0, 48.0, points))


@pytest.mark.parametrize(
    ("wrong_px", "sound"),
    [(0.0, True), (5.8e-5, True), (7e-5, False), (5e-4, False), (np.nan, False)],
)
@pytest.mark.parametrize("size", [(64, 48), (48, 64)])
def test_the_way_back_ends_within_a_millionth_of_the_longer_side(
    wrong_px: float, sound: bool, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of any point, also of those whose numbers are large."""
    map_ = Map.filling(size)
    monkeypatch.setattr(Map, "from_field", lambda _, field: field * size + wrong_px)
    if sound:
        assert check_map(map_, "mask") is map_
        return
    with pytest.raises(ConfigError, match="cannot be inverted over the whole device"):
        check_map(map_, "mask")


@pytest.mark.parametrize(
    ("one", "rest", "sound"),
    [(1.0, 1.0, True), (-1.0, -1.0, True), (0.0, 1.0, False), (0.0, -1.0, False),
     (-1.0, 1.0, False), (1.0, -1.0, False), (np.nan, 1.0, False)],
)  # fmt: skip
def test_a_map_turns_nowhere_over_and_is_nowhere_flat(
    one: float, rest: float, sound: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slopes(_: Map, points: Any) -> Any:
        found = np.tile(np.diag([1.0, rest]), (*points.shape[:-1], 1, 1))
        found[7, 9, 1, 1] = one
        return found

    monkeypatch.setattr(Map, "jacobian", slopes)
    if sound:
        assert check_map(GOOD, "mask") is GOOD
        return
    with pytest.raises(ConfigError, match="folds"):
        check_map(GOOD, "mask")


def test_no_warning_comes_of_a_map_that_is_refused() -> None:
    """Its numbers overflow, or its horizon runs through the device."""
    for homography in (
        (1e308, 0.0, 0.0, 0.0, 1e308, 0.0, 0.0, 0.0, 1.0),
        (0.01, 0.0, 0.0, 0.0, 0.01, 0.0, -1.0 / 32.0, 0.0, 1.0),
    ):
        with pytest.raises(ConfigError):
            check_map(Map(size_px=(64, 48), homography=homography), "mask")
