"""Fixtures that all tests share."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from tests import remembered
from tests.heard import Heard
from tests.xserver import x_full, x_quarter

__all__ = ["heard", "x_full", "x_quarter"]

# A shell without job control starts what runs in its background with interrupts ignored, and that
# is passed on: tests that interrupt themselves or a child would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

remembered.begin()


@pytest.fixture(autouse=True)
def heard() -> Iterator[Heard]:
    """In every test, each event is what the schema says; a test may look at what was heard."""
    with pytest.MonkeyPatch.context() as patch:
        recorder = Heard()
        recorder.listen(patch)
        yield recorder
    assert not recorder.faults, "\n".join(recorder.faults[:5])
