"""Maps that cannot be used: each is refused by what is wrong with it."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.errors import ConfigError
from pdcd.panels.map import Map, to_map_matrix
from pdcd.panels.map_soundness import check_map, check_share, compute_field_share

GOOD = Map.filling((64, 48))
FOLD = tuple(tuple((40.0 * (col % 2), 0.0) for col in range(9)) for _ in range(3))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"homography": (np.nan, 0, 0, 0, 1, 0, 0, 0, 1)}, "not finite"),
        ({"radial": (np.inf, 0.0)}, "not finite"),
        ({"residual": ((((0.0, np.nan),) * 2,) * 2)}, "residual that is not finite"),
        ({"residual": (((0.0, 0.0),) * 2,)}, "no grid"),
        ({"residual": (((0.0, 0.0),) * 3, ((0.0, 0.0),) * 2)}, "no grid"),
        ({"residual": (((0.0, 0.0),) * 33,) * 2}, "no grid"),
        ({"size_px": (0, 48)}, "0 x 48 pixels"),
        ({"size_px": (10**9, 10**9)}, "pixels"),
        ({"homography": (1, 2, 0, 2, 4, 0, 0, 0, 1)}, "singular"),
        ({"homography": (0,) * 9}, "singular"),
        ({"homography": (0.01, 0, 0, 0, 0.01, 0, -0.02, 0, 1)}, "beyond infinity"),
        ({"homography": (1e6, 0, 0, 0, 0.02, 0, 0, 0, 1)}, "fields away"),
        ({"radial": (-0.5, 0.0)}, "folds"),
        ({"residual": FOLD}, "folds"),
    ],
)
def test_it_is_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        check_map(msgspec.structs.replace(GOOD, **change), "mask")
    assert caught.value.device == "mask"
    assert "mask" in caught.value.message
    assert "\n" not in caught.value.message


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_mirrored_maps_are_sound(mirror: float) -> None:
    map_ = GOOD.then([[mirror, 0.0, 0.5 - 0.5 * mirror], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert check_map(map_, "mask") is map_


def test_the_share_of_the_field_is_that_of_its_area() -> None:
    assert compute_field_share(GOOD) == 1.0
    half = GOOD.then([[0.5, 0.0, 0.25], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert compute_field_share(half) == pytest.approx(0.5, abs=1e-9)
    quarter = GOOD.then(np.diag([0.5, 0.5, 1.0]))
    check_share(quarter, "mask")
    little = GOOD.then(np.diag([0.4, 0.5, 1.0]))
    with pytest.raises(ConfigError, match=r"covers .* of the field only"):
        check_share(little, "mask")
    check_share(little, "camera", least=0.0)


def test_a_device_beside_the_field_is_refused() -> None:
    beside = GOOD.then([[1.0, 0.0, 1.5], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert compute_field_share(beside) == 0.0
    with pytest.raises(ConfigError, match="beside the field"):
        check_share(beside, "camera", least=0.0)


def test_matrices_are_held_with_their_last_number_one() -> None:
    assert to_map_matrix(np.diag([2.0, 4.0, 2.0]))[-1] == 1.0
