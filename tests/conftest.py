"""Fixtures that all tests share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.heard import Heard
from tests.xserver import x_full, x_quarter

__all__ = ["heard", "x_full", "x_quarter"]


@pytest.fixture(autouse=True)
def heard() -> Iterator[Heard]:
    """In every test, each event is what the schema says; a test may look at what was heard."""
    with pytest.MonkeyPatch.context() as patch:
        recorder = Heard()
        recorder.listen(patch)
        yield recorder
    assert not recorder.faults, "\n".join(recorder.faults[:5])
