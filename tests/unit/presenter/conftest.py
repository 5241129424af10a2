"""The driver's side of a display process that a test holds."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from pdcd.presenter.client import DisplayProcess
from tests.child_rig import stand_ins
from tests.unit.presenter.client_bench import Bench


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    for children in stand_ins(monkeypatch):
        bench = Bench(monkeypatch, children)
        yield bench
        for process in bench.made:
            process.kill()


@pytest.fixture
def process(bench: Bench) -> DisplayProcess:
    made = bench.started()
    bench.heard()
    return made
