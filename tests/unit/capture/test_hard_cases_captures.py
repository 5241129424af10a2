"""Captures of hard scenes are as good as the camera's rounding allows, and say when they know
nothing."""

from __future__ import annotations

import pytest

from tests.hard_cases import captures
from tests.hard_cases.case import Case, check


@pytest.mark.long
@pytest.mark.parametrize("case", captures.CASES, ids=lambda c: c.name)
def test_error_stays_below_its_bound(case: Case) -> None:
    check(case)
