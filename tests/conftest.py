"""Fixtures that all tests share."""

from tests.xserver import x_full, x_quarter

__all__ = ["x_full", "x_quarter"]
