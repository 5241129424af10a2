"""X servers for everything in this folder, and software rendering in whatever draws on them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.xserver import x_full, x_quarter

__all__ = ["x_full", "x_quarter"]


@pytest.fixture(autouse=True)
def _software(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
    monkeypatch.setenv("LP_NUM_THREADS", "1")
    yield
