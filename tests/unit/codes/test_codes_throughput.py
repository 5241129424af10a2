"""Codes are made fast enough, and in little enough memory, for a user who waits."""

from __future__ import annotations

import pytest

from tests.bench.hard_cases import CODE_LIMITS
from tests.bench.measure import alone


@pytest.mark.long
def test_512_coloured_codes_take_little_memory() -> None:
    """In a process of its own, so that the memory is that of the codes alone; 106 MiB are
    usual."""
    grid, count, _, limit_mib = CODE_LIMITS[0]
    made = alone("hard_cases:codes", grid=grid, count=count)
    assert made["peak_mib"] < limit_mib / 8.0
