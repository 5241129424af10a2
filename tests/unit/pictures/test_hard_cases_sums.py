"""Long sums and small differences of large numbers keep their digits."""

from __future__ import annotations

import pytest

from tests.hard_cases import differences, sums
from tests.hard_cases.case import Case, check


@pytest.mark.long
@pytest.mark.parametrize("case", [*sums.CASES, *differences.CASES], ids=lambda c: c.name)
def test_error_stays_below_its_bound(case: Case) -> None:
    check(case)
