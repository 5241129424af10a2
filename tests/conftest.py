"""Fixtures that all tests share."""

import signal

from tests import remembered
from tests.xserver import x_full, x_quarter

__all__ = ["x_full", "x_quarter"]

# A shell without job control starts what runs in its background with interrupts ignored, and that
# is passed on: tests that interrupt themselves or a child would wait for ever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

remembered.begin()
