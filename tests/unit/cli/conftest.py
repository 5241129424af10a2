"""What the tests of the command line share: a home that is empty, and stand-ins."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.cli.cli_stubs import StubClient, StubEngine, home_at, stub_daemon, stub_engine


@pytest.fixture(autouse=True)
def _alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    home_at(monkeypatch, tmp_path)


@pytest.fixture
def daemon(monkeypatch: pytest.MonkeyPatch) -> type[StubClient]:
    return stub_daemon(monkeypatch)


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> type[StubEngine]:
    return stub_engine(monkeypatch)
