"""What the tests of this room share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.coroutines import pytest_pyfunc_call
from tests.e2e.server._server_harness import nothing_left
from tests.e2e.server._users import Users
from tests.heard import Heard

__all__ = ["pytest_pyfunc_call"]


@pytest.fixture(autouse=True)
def _nothing_left() -> Iterator[None]:
    with nothing_left():
        yield


@pytest.fixture(autouse=True)
def heard() -> Iterator[Heard]:
    """Each event of a test is what the schema says; a test may look at what was heard."""
    with pytest.MonkeyPatch.context() as patch:
        recorder = Heard()
        recorder.listen(patch)
        yield recorder
    assert not recorder.faults, "\n".join(recorder.faults[:5])


@pytest.fixture
def _own_folder(tmp_path: Path) -> Path:
    """Of the daemon of a `served` test."""
    return tmp_path


@pytest.fixture
def users(monkeypatch: pytest.MonkeyPatch) -> Users:
    return Users(monkeypatch)
