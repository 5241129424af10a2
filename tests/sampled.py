"""Cases of which `make test` runs some, and `make test-long` the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest


def sampled(cases: Sequence[Any], every: int) -> list[Any]:
    """The cases for `pytest.mark.parametrize`: the first and each `every`th after it as they are,
    all others marked as long."""
    return [case if n % every == 0 else _long(case) for n, case in enumerate(cases)]


def _long(case: Any) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.long)
