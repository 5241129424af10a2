"""Fixtures that all tests share."""

from __future__ import annotations

import gc
import signal
from collections.abc import Generator, Iterator

import pytest
from hypothesis import HealthCheck, settings

from tests import world

world.enter()  # before pdcd is imported, and whatever tests run while they are imported

from tests.xserver import x_quarter

__all__ = ["x_quarter"]

# The same cases every time, and none fails because the machine is busy.
settings.register_profile(
    "pdcd", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("pdcd")

# A shell without job control starts what runs in its background with interrupts ignored, and that
# is passed on: tests that interrupt themselves or a child would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Of a million new objects none is rubbish: it is not looked for among them, now or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(autouse=True)
def _own_world() -> Iterator[None]:
    """Every test finds no configuration, runs or calibrations of another."""
    yield
    world.sweep()
