"""What the tests of this room share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.coroutines import pytest_pyfunc_call
from tests.e2e.server._server_harness import nothing_left
from tests.e2e.server._users import Users

__all__ = ["pytest_pyfunc_call"]


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    with nothing_left():
        yield


@pytest.fixture
def _own_folder(tmp_path: Path) -> Path:
    """Of the daemon of a `served` test."""
    return tmp_path


@pytest.fixture
def users(monkeypatch: pytest.MonkeyPatch) -> Users:
    return Users(monkeypatch)
