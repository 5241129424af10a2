"""Codes -> refreshes."""

from __future__ import annotations

import numpy as np
import pytest

from pdcd.codes.make import make_codes
from pdcd.errors import ConfigError
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import build_frames
from pdcd.planning.bench_fit import choose_window
from tests import bench_rig


def test_paper_counts() -> None:
    """Printed 512 codes are 128 pairs under 4 shifts: 1536 refreshes, 25.6 s at 60 Hz (H5)."""
    codes = make_codes("hadamard", (49, 65), 128, dual="complement")
    frames = build_frames(
        bench_rig.pairs(codes), (48, 64), window="quarter", schedule="full", passes=1
    )
    assert len(frames) == 1536
    assert len(frames) / 60.0 == pytest.approx(25.6)


@pytest.mark.parametrize(
    ("asked", "cells", "got"),
    [("auto", 0.0, "whole"), ("auto", 0.2, "quarter"), ("whole", 0.2, "whole"),
     ("quarter", 0.0, "quarter"), ("auto", 0.25, "quarter"), ("auto", 0.001, "whole"),
     ("auto", 0.01, "quarter")],
)  # fmt: skip
def test_window_choice(asked: str, cells: float, got: str) -> None:
    assert choose_window(asked, cells) == got


def test_misregistration_beyond_quarter_windows_is_refused() -> None:
    with pytest.raises(ConfigError, match="misregistration"):
        choose_window("auto", 0.3)


@pytest.mark.parametrize("window", ["whole", "quarter", "side-5/8", "side-7/8"])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.1, -0.2), (0.5, 0.5), (-0.75, 0.25)])
def test_overlaps_partition_every_cell(window: str, offset: tuple[float, float]) -> None:
    lattice = Lattice((3, 5), window, offset)
    assert sum(o.area for o in lattice.overlaps) == pytest.approx(1.0, rel=1e-14)
    np.testing.assert_allclose(lattice.spread.sum(axis=0), 1.0, rtol=1e-14)


@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_an_open_mask_ends_at_its_border(window: str) -> None:
    """Half a cell too far down, the last row of cells is half beyond the panel's cells."""
    lattice = Lattice((3, 5), window, (0.5, 0.0))
    seen = (lattice.dual_field_uniform(1.0).ravel() @ lattice.spread).reshape(3, 5)
    inside = 1.0 if window == "whole" else 2.0  # quarter windows have a cell to spare
    open_share = seen / seen[0, 0]
    np.testing.assert_allclose(open_share[:2], 1.0)
    np.testing.assert_allclose(open_share[2], 0.5 if inside == 1.0 else 1.0)
