"""Nearly singular wishes are granted as exactly as patterns in single precision can."""

from __future__ import annotations

import pytest

from tests.hard_cases import matrices
from tests.hard_cases.case import Case, check


@pytest.mark.parametrize("case", matrices.CASES, ids=lambda c: c.name)
def test_error_stays_below_its_bound(case: Case) -> None:
    check(case)
