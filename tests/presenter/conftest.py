"""A large X server, and software rendering in whatever draws on any."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.xserver import FULL, XServer, hurry, run


@pytest.fixture(scope="session")
def x_full() -> Iterator[XServer]:
    """Panels at full size, for comparing pixels."""
    with run(*FULL) as server:
        hurry(server)
        yield server


@pytest.fixture(autouse=True)
def _software(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
    monkeypatch.setenv("LP_NUM_THREADS", "0")
    yield
