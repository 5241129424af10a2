"""24 binary patterns in one RGB picture."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.panels.patterns import BIT_PLANES, split_planes
from tests.panel_pixels import pack_words

ORDERS = ("RGB", "RBG", "GRB", "GBR", "BRG", "BGR")


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("plane", [0, 7, 8, 16, 23])
def test_one_plane_is_one_bit(order: str, plane: int) -> None:
    """Pattern numbers 0 to 23 are G0..G7, R0..R7, B0..B7 (DLPC350), or as the order says."""
    planes = np.zeros((BIT_PLANES, 2, 3), dtype=np.bool_)
    planes[plane, 1, 2] = True
    picture = split_planes(pack_words(planes), order)
    want = np.zeros((2, 3, 3), dtype=np.uint8)
    want[1, 2, {"R": 0, "G": 1, "B": 2}[order[plane // 8]]] = 2 ** (plane % 8)
    np.testing.assert_array_equal(picture, want)


def unpack_planes(picture: NDArray[np.uint8], order: str) -> NDArray[np.bool_]:
    """The 24 patterns of an RGB picture (..., 3) in the order they are shown, (24, ...) bool."""
    channels = [picture[..., "RGB".index(order[plane // 8])] for plane in range(BIT_PLANES)]
    return np.stack([(c >> plane % 8) % 2 == 1 for plane, c in enumerate(channels)])


@settings(max_examples=30)
@given(
    planes=arrays.arrays(
        np.bool_, st.tuples(st.integers(0, BIT_PLANES), st.integers(1, 5), st.integers(1, 7))
    ),
    order=st.sampled_from(ORDERS),
)
def test_packing_loses_nothing(planes: NDArray[np.bool_], order: str) -> None:
    """The inverse gives the patterns again; those that are missing come back black."""
    again = unpack_planes(split_planes(pack_words(planes), order), order)
    np.testing.assert_array_equal(again[: len(planes)], planes)
    assert not again[len(planes) :].any()


def test_bad_input_is_refused() -> None:
    with pytest.raises(ConfigError, match="order"):
        split_planes(np.zeros((1, 1), dtype=np.uint32), "RGG")
