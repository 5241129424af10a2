"""X servers for everything in this folder, and software rendering in whatever draws on them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests import x11_rig
from tests.xserver import FULL, QUARTER, XServer, run


@pytest.fixture(scope="session")
def x_quarter() -> Iterator[XServer]:
    """Panels of a quarter of their size, which software rendering serves at 60 Hz."""
    with run(*QUARTER) as server:
        x11_rig.hurry(server)
        yield server


@pytest.fixture(scope="session")
def x_full() -> Iterator[XServer]:
    """Panels at full size, for comparing pixels."""
    with run(*FULL) as server:
        x11_rig.hurry(server)
        yield server


@pytest.fixture(autouse=True)
def _software(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
    monkeypatch.setenv("LP_NUM_THREADS", "0")
    yield
