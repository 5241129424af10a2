"""The closed form of slow panels keeps its digits where its terms cancel or vanish."""

from __future__ import annotations

import pytest

from tests.hard_cases import panels
from tests.hard_cases.case import Case, check


@pytest.mark.parametrize("case", panels.CASES, ids=lambda c: c.name)
def test_error_stays_below_its_bound(case: Case) -> None:
    check(case)
