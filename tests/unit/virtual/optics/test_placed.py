"""Whole photos on benches that lie anywhere: drawn, seen and decoded by one set of maps."""

from __future__ import annotations

import msgspec
import pytest

from pdcd.bench.tables import PanelConfig
from tests.bench.placed import Found, aligned, anywhere, judge

PANEL = PanelConfig(size_px=(256, 192))
CONFIG = msgspec.structs.replace(aligned((12, 16), (88, 66)), projector=PANEL, mask=PANEL)
CODES = 32


@pytest.fixture(scope="module")
def best() -> Found:
    return judge(CONFIG, CODES)


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 8])
def test_a_bench_that_lies_anywhere_is_as_good_as_an_aligned_one(seed: int, best: Found) -> None:
    found = judge(anywhere(CONFIG, seed), CODES)
    assert found.rms_error < 2.0 * best.rms_error
    assert found.at_pitch < 0.005
