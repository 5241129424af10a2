"""Virtual scenes are right at the limits of brightness, albedo and shape."""

from __future__ import annotations

import pytest

from tests.hard_cases import scenes
from tests.hard_cases.case import Case, check


@pytest.mark.long
@pytest.mark.parametrize("case", scenes.CASES, ids=lambda c: c.name)
def test_error_stays_below_its_bound(case: Case) -> None:
    check(case)
